"""Short episodes in which every device and every feature is active, and the figures of them that a file records.

    python tests/dcgrid_env/devices/recorded_episodes.py

rewrites ``recorded_episodes.json``. Only a change that is meant to change a figure may do this, and must state it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env import (
    METRICS,
    Fault,
    Metric,
    PowerCapDvfs,
    PrefillDecodeDvfs,
    Recorder,
    Scenario,
    action_layout,
    make_scenario,
)
from dcgrid_env.engine.simulation import Simulation

sys.path.append(str(Path(__file__).parents[2] / "support"))

from helpers.riding import ride_through_34, riding
from helpers.routing import routed
from helpers.storages import toy6_storage
from helpers.three_phase import ieee13

FILE = Path(__file__).with_suffix(".json")
HELD_STEPS = 3
"""Steps for which a random action stays, so that delays and ramps go on for more than one."""
LARGE = {"datacenters.storage": {"p_rated_kw": 200.0, "energy_kwh": 1.0, "ageing_price": 0.05}}
BY_POWER = {"measures": "kvar", "on_above_share": 0.55, "off_below_share": -0.46, "delay_s": 1.0}
BY_VOLTAGE = {"measures": "voltage", "on_below_pu": 0.965, "off_above_pu": 0.985, "delay_s": 2.0}
SMOOTHED = {"datacenters.smoothing": {"control": "agent", "hysteresis_s": 2.0, "change_every_s": 3.0}}


def _all_features() -> Scenario:
    return routed(
        horizon=60,
        dt_s=0.5,
        **LARGE,
        **SMOOTHED,
        **{"datacenters.cooling": {"time_constant_s": 5.0}, "datacenters.boost_share": 1.2},
    )


def _two_classes() -> Scenario:
    law = PrefillDecodeDvfs()
    service = {"target_s": 1.0, "deadline_s": 6.0, "order": "edf"}
    return routed(horizon=60, dt_s=0.5, **{"datacenters.clock_law": law, "datacenters.service": service})


def _power_cap() -> Scenario:
    smoothing = {"floor_share": 0.6, "hysteresis_s": 3.0, "ramp_up_w_per_s": 50_000.0}
    return make_scenario(
        "ieee33-weak",
        horizon=60,
        dt_s=0.5,
        **{"datacenters.clock_law": PowerCapDvfs(), "datacenters.smoothing": smoothing},
    )


def _requests() -> Scenario:
    return make_scenario(
        "ieee33", horizon=60, dt_s=0.5, trace="deepseek-v3", **{"datacenters.clock_law": PrefillDecodeDvfs()}
    )


def _leaving() -> Scenario:
    rule = {"curve": "itic", "release": "staggered", "by_hand_s": 8.0, "stagger_s": 3.0, "battery_s": 6.0}
    weights = {"trip_weight": 1.0, "away_weight": 0.5, "on_battery": "waits", "recharge_share": 0.3}
    inverters = {"curve": "itic", "return_delay_s": 4.0, "walk_in_s": 3.0, "trip_weight": 0.5}
    return riding(
        horizon=220,
        dt_s=0.5,
        **{
            "datacenters.ride_through": rule | weights,
            "datacenters.cooling": {},
            "datacenters.idle_share": 0.2,
            "inverters.ride_through": inverters,
        },
    )


def _leaving_by_agent() -> Scenario:
    return ride_through_34(horizon=60, dt_s=2.0)


def _leaving_with_routing() -> Scenario:
    rule = {"curve": "itic", "return_delay_s": 2.0, "by_hand_s": 10.0, "battery_s": 8.0}
    lost = Fault(("datacenter", "inverter"), begin_s=(5.0, 30.0), duration_s=(10.0, 20.0))
    changes: dict[str, Any] = {"datacenters.ride_through": rule, "weights": {"clock": 1.0}}
    return routed(horizon=140, dt_s=0.5, sags="virginia-2024", faults=(lost,), **changes)


def _storages() -> Scenario:
    return toy6_storage(60, {"energy_kwh": 1.0, "initial_share": 0.9, "s_rated_kva": (350.0, 400.0)}, dt_s=0.5)


def _three_phases(regulators: str, capacitors: str, capacitor_settings: Any) -> Scenario:
    """Sites that draw up to 1.5 MW each, so that controls act."""
    control = {"regulators": regulators, "capacitors": capacitors, "capacitor_settings": capacitor_settings}
    changes = {"datacenters.p_rated_kw": 1500.0, "trace": "step", "workload.window": "start", "sensing.regulator": True}
    timers = {"regulator_settings": {"timer": "reset"}}
    return ieee13().replace(horizon=150, grid_control=control | timers, weights={"switching": 0.1}, **changes)


SCENARIOS: dict[str, Callable[[], Scenario]] = {
    "all features": _all_features,
    "two classes of work": _two_classes,
    "power cap": _power_cap,
    "requests": _requests,
    "leaving": _leaving,
    "leaving by agent": _leaving_by_agent,
    "leaving with routing": _leaving_with_routing,
    "storages": _storages,
    "agents of equipment": lambda: _three_phases("agent", "agent", {}),
    "set points of equipment": lambda: _three_phases("setpoint", "setpoint", {"measures": "voltage", "delay_s": 2.0}),
    "controlled by power": lambda: _three_phases("controlled", "controlled", BY_POWER),
    "controlled by voltage": lambda: _three_phases("controlled", "controlled", BY_VOLTAGE),
}


def of_scenario(scenario: Scenario) -> dict[str, Any]:
    """Return what the devices declare, and figures of an episode under random actions."""
    layout, simulation = action_layout(scenario), Simulation(scenario, 1)
    rng, begun, action = np.random.default_rng(0), simulation.reset([3]), np.zeros((1, layout.n))
    recorder, observed = Recorder(scenario, begun), [_digest(begun.observation)]
    for step in range(scenario.horizon):
        if step % HELD_STEPS == 0:
            action = rng.uniform(-1.0, 1.0, (1, layout.n))
        transition = simulation.step(action)
        recorder.add(transition)
        observed.append(_digest(transition.observation))
    series = recorder.series(0)
    return {
        "declared": [_declared(device, scenario) for device in scenario.devices],
        "display": {name: _display(METRICS[name]) for name in series.metrics()},
        "metrics": {name: float(value) for name, value in series.metrics().items()},
        "costs": {name: float(np.sum(charged)) for name, charged in series.costs.items()},
        "observed": observed,
    }


def _digest(observation: np.ndarray) -> float:
    """A sum of all figures in which each counts by another weight."""
    figures = np.asarray(observation, np.float64).ravel()
    return float(figures @ np.cos(np.arange(len(figures))))


def _display(metric: Metric) -> list[Any]:
    rules = metric.better, metric.over_parts, metric.over_episodes, metric.share_of
    return [metric.text(1234.56789), metric.of_episodes([1.0, 2.0, 6.0]), *rules]


def _declared(device: Any, scenario: Scenario) -> dict[str, Any]:
    of_steps = scenario.horizon, scenario.dt_s
    records = {
        "channels": device.channels,
        "fields": device.fields(*of_steps),
        "cost_terms": device.cost_terms(*of_steps),
    }
    limits = [device.q_limit_kvar, device.converter_kva, device.p_scale_kw, device.largest_draw_share]
    return {part: [_plain(record) for record in of_part] for part, of_part in records.items()} | {
        "limits": _plain(limits)
    }


def _plain(record: Any) -> Any:
    """Return a record as nested lists, numbers with 12 digits."""
    if isinstance(record, np.ndarray):
        return _plain(record.tolist())
    if isinstance(record, tuple | list):
        return [_plain(value) for value in record]
    return float(f"{record:.12g}") if isinstance(record, float) else record


def main() -> None:
    """Write the file."""
    lines = (f"{json.dumps(name)}: {json.dumps(of_scenario(make()))}" for name, make in SCENARIOS.items())
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
