"""An episode as the replay's page takes it: whole numbers that are small to write, by node, agent and equipment."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.devices.device import may_leave
from dcgrid_env.devices.grid_equipment import is_equipment
from dcgrid_env.engine.exogenous import episode
from dcgrid_env.engine.physics.acting_relays import acting_relays
from dcgrid_env.engine.record.episode_record import Series
from dcgrid_env.scenario.grid_control import regulator_deciders

VOLTAGE_DECIMALS = 4
_COST_DECIMALS = 5


class Shown(NamedTuple):
    """A figure of an agent over time."""

    label: str
    unit: str
    decimals: int


SHOWN = {
    "p_kw": Shown("power drawn", "kW", 1),
    "p_ref_kw": Shown("demand", "kW", 1),
    "q_kvar": Shown("reactive power injected", "kvar", 1),
    "f_mhz": Shown("GPU clock", "MHz", 0),
    "backlog_kws": Shown("backlog", "kW s", 0),
    "stored_pct": Shown("stored energy", "%", 1),
    "burnt_kw": Shown("power burnt", "kW", 1),
    "on_grid_pct": Shown("share on the grid", "%", 0),
}
"""What a page shows of agents, in its order."""


def course(run: Series) -> dict[str, Any]:
    """What the page has of one episode; times run from the reset on, (T + 1,)."""
    phases = run.three_phase
    equipment = {}
    if phases is not None:
        taps, banks = phases.equipment.regulators.tap, phases.equipment.banks.on
        lost = _lost(run)[:, run.scenario.n_agents :]
        on = np.where(lost, -1.0, (banks > 0.5) & run.scenario.background.capacitors)
        equipment = {
            "tap": [packed(of_one, 0) for of_one in taps.T],
            "on": [packed(of_one, 0) for of_one in on.T],
            "unbalance_pct": packed(100.0 * phases.unbalance.max(axis=1, initial=0.0), 2),
        }
        if (relays := relay_curves(run)) is not None:
            equipment |= {"relay": [None] * len(taps.T), "timer": [None] * len(taps.T)}
            for row, off, timer_s in zip(relays.rows, relays.half_bands_off.T, relays.timer_s.T, strict=True):
                equipment["relay"][row], equipment["timer"][row] = packed(off, 2), packed(timer_s, 0)
    return {
        "steps": len(run.v_pu),
        "converged": run.converged,
        "j": packed(np.append(0.0, np.cumsum(run.cost_j) / run.scenario.horizon), _COST_DECIMALS),
        "v": [packed(of_node, VOLTAGE_DECIMALS) for of_node in run.v_pu.T],
        "agents": [
            {name: packed(values, SHOWN[name].decimals) for name, values in figures.items()}
            for figures in agent_figures(run)
        ],
        **equipment,
    }


class RelayCurves(NamedTuple):
    """Relays of regulators over time, (T + 1, R) for those in the rows (R,) of the regulators' table."""

    rows: np.ndarray
    half_bands_off: np.ndarray
    """Relay volts minus the target, in half bands."""
    timer_s: np.ndarray


def relay_curves(run: Series) -> RelayCurves | None:
    """Return the relays that act on a feeder; None without such relays, or if set points change in an episode."""
    relays, control = acting_relays(run.scenario), run.scenario.grid_control
    if relays is None or control.regulator_settings.has_schedules:
        return None
    if "setpoint" in regulator_deciders(control, run.scenario.feeder):
        return None
    rows, measured = relays.rows, run.three_phase.equipment.regulators
    off_v = measured.relay_v[:, rows] - relays.settings.target_v[rows]
    return RelayCurves(rows, off_v / relays.settings.half_band_v[rows], measured.out_of_band_s[:, rows])


def packed(values: np.ndarray, decimals: int) -> dict[str, Any]:
    """A figure over time, (T + 1,), as its first differences in units of its last decimal; None for a NaN."""
    units = np.round(np.asarray(values, np.float64) * 10.0**decimals)
    known = np.isfinite(units)
    steps = iter(np.diff(units[known], prepend=0.0).astype(np.int64).tolist())
    return {"k": decimals, "d": [next(steps) if is_known else None for is_known in known.tolist()]}


def agent_figures(run: Series) -> list[dict[str, np.ndarray]]:
    """Return the available figures of ``SHOWN`` by agent, (T + 1,) each; none for equipment of the feeder."""
    s, rows = run.scenario, len(run.v_pu)
    q_kvar = np.vstack((np.zeros((1, s.n_agents)), run.q_kvar))
    figures: list[dict[str, np.ndarray]] = [{} for _ in range(s.n_agents)]
    connected = np.where(_lost(run)[:, : s.n_agents], 0.0, 100.0)
    may_be_away = np.zeros(s.n_agents, bool) | bool(s.faults)
    site = 0
    for device, state, agents in of_devices(run):
        if is_equipment(device):
            continue
        if may_leave(device):
            connected[:, agents] *= device.connected(state)
            may_be_away[agents] = True
        works = device.input == "workload"
        device_figures = _site_figures(run, state, site, device.count) if works else {}
        site += device.count * works
        device_figures |= _stored(device, state)
        for slot, i in enumerate(agents):
            figures[i] = {"p_kw": run.p_kw_from_reset[:, i], "q_kvar": q_kvar[:, i]}
            figures[i] |= {name: values[:rows, slot] for name, values in device_figures.items()}
            if may_be_away[i]:
                figures[i]["on_grid_pct"] = connected[:, i]
    return [{name: device_figures[name] for name in SHOWN if name in device_figures} for device_figures in figures]


def of_devices(run: Series) -> Iterator[tuple[Any, Any, range]]:
    """Each group of devices with its state over time and the positions of its agents."""
    first = 0
    for device, state in zip(run.scenario.devices, run.devices, strict=True):
        yield device, state, range(first, first + device.count)
        first += device.count


def p_ref_kw(run: Series) -> np.ndarray:
    """Power asked of the sites in the interval that ends at each step, kW, (T + 1, n_site)."""
    return episode.asked_kw(run.scenario, run.trace_start, np.arange(len(run.v_pu)))


def _site_figures(run: Series, state: Any, first: int, count: int) -> dict[str, np.ndarray]:
    requested_kw = p_ref_kw(run)[:, first : first + count]
    burnt = {"burnt_kw": state.burnt_kw} if hasattr(state, "burnt_kw") else {}
    return {"p_ref_kw": requested_kw, "f_mhz": state.f_mhz, "backlog_kws": state.backlog_kws, **burnt}


def _stored(device: Any, state: Any) -> dict[str, np.ndarray]:
    """Energy of storages, behind a site's converter too, as a share of what they can store, where there are any."""
    if hasattr(state, "stored_kwh"):
        return {"stored_pct": 100.0 * state.stored_kwh / device.parameters.energy_kwh}
    if hasattr(state, "storage"):
        sizes = next(feature for feature in device.features if hasattr(feature, "energy_kwh")).params(device.count)
        return {"stored_pct": 100.0 * state.storage.stored_kwh / sizes.energy_kwh}
    if hasattr(state, "battery"):  # that of a UPS begins full
        return {"stored_pct": 100.0 * state.battery.stored_kws / np.maximum(state.battery.stored_kws[:1], 1e-9)}
    return {}


def _lost(run: Series) -> np.ndarray:
    """What a fault has taken, bool, (T + 1, n_agent + n_capacitor)."""
    s, rows = run.scenario, len(run.v_pu)
    if not s.faults:
        return np.zeros((rows, s.n_agents + len(s.capacitor_connected)), bool)
    return episode.lost(s, np.broadcast_to(run.fault, (rows, *run.fault.shape)), np.arange(rows))
