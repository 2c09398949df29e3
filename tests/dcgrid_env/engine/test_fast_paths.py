"""Fast paths give the results of the general path, also where a contributor has added to what they know.

Each test of an addition does what docs/architecture.md says: it adds a field with a default to a class and uses it in
the general path.
"""

from __future__ import annotations

from operator import attrgetter
from typing import Any

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.devices import DataCenters, Inverters, Storages
from dcgrid_env.devices.capacitor_bank.capacitor_control import CapacitorControl
from dcgrid_env.devices.datacenter.clock_law import LinearDvfs
from dcgrid_env.devices.tap_changer.regulator_control import RegulatorControl
from dcgrid_env.engine.cost import reward
from dcgrid_env.engine.physics import dynamics, grid_pass, loads
from dcgrid_env.engine.physics.state import Exogenous, LoadsToDraw
from dcgrid_env.grid import Feeder
from dcgrid_env.scenario.cost import Cost
from dcgrid_env.scenario.grid_control import GridControl
from dcgrid_env.scenario.grid_request import GridRequest
from dcgrid_env.scenario.load_profiles import LoadProfiles
from dcgrid_env.scenario.presets import PRESETS
from dcgrid_env.scenario.scenario import Scenario
from dcgrid_env.scenario.sensing import Sensing
from dcgrid_env.scenario.workload import Background, Workload
from dcgrid_env.traces import PowerTrace
from helpers.fast_paths import NAME, add_field, altered, assert_same, both_ways, edit, fast_paths, results

BALANCED, THREE_PHASE = "ieee33-weak", "ieee13-3ph"
POWER_KW = np.random.default_rng(0).uniform(0.85, 1.0, 900)
BUSY = {"workload": {"trace": PowerTrace(np.arange(900.0), POWER_KW, "busy")}, "horizon": 3}
"""Sites with more work than they serve, so that all their costs count."""
BURSTS = {"trace": PowerTrace(np.arange(900.0), POWER_KW, "bursts", rated_kw=0.85)}
COUNTED = ("voltage", "violation", "backlog", "effort", "clock", "leftover")
"""Cost terms that must count in a comparison if they have a weight."""


def scenario_of(preset: str, **overrides: Any) -> Any:
    """A preset with busy sites; on a three-phase feeder steps are so long that taps move."""
    length = {"dt_s": 20.0} if preset == THREE_PHASE else {}
    return make_scenario(preset, **(BUSY | length | overrides))


def assert_alike(scenario: Any, n_env: int = 1) -> list[Any]:
    """The same steps with and without fast paths; returns their results."""
    fast, general = both_ways(scenario, n_env)
    assert_same(results(fast), results(general))
    return fast


def assert_addition_counts(before: Any, after: Any) -> None:
    """The addition changes results, and in the same way with fast paths."""
    assert fast_paths(before)
    found, plain = results(assert_alike(after)), results(assert_alike(before))
    with pytest.raises(AssertionError):
        assert_same(found[1:], plain[1:])


ON_GRID_PASS = """
    toy6 ieee123 ieee33-weak ieee33 das69 khodr141 bursty sync training mixed wrong-model scale-32 robust
    late-measurements ieee33-weak-ups smoothing routing load-target
"""


@pytest.mark.slow
def test_presets_that_take_the_grid_pass():
    assert {name for name in PRESETS if grid_pass.fits(make_scenario(name))} == set(ON_GRID_PASS.split())


@pytest.mark.parametrize(
    ("preset", "n_env", "overrides"),
    [
        ("ieee33-weak", 1, {"cost": {"weights": {"clock": 3.0}}}),
        ("ieee33-weak", 3, {"cost": {"weights": {"clock": 3.0}, "band_pu": 0.02}, "reward": "difference"}),
        ("ieee33-weak", 12, {"cost": {"weights": {"clock": 3.0}}}),
        ("ieee33-weak", 1, {"inverters": {"injection": "pv"}, "background": {"capacitors": False}}),
        (
            "ieee33-weak",
            2,
            {
                "datacenters": {"boost_share": 1.2},
                "workload": BURSTS,
                "sensing": {"preview": False, "r_model_share": 0.5},
            },
        ),
        ("ieee33-weak", 2, {"sensing": {"noise_pu": 0.003, "delay_steps": 2}, "reward": "local"}),
        ("ieee123", 1, {"background": {"start_hour": 18.0}, "source_voltage_pu": 1.03}),
        ("smoothing", 1, {}),
        ("load-target", 2, {}),
        ("ieee13-3ph", 1, {"cost": {"weights": {"clock": 3.0}}}),
        pytest.param(
            "ieee13-3ph", 3, {"cost": {"weights": {"clock": 3.0}}, "reward": "difference"}, marks=pytest.mark.slow
        ),
    ],
)
def test_results_of_the_general_path(preset, n_env, overrides):
    scenario = scenario_of(preset, **overrides)
    assert fast_paths(scenario, n_env)
    snapshots = assert_alike(scenario, n_env)
    costs = {name: sum(s.transition.costs._asdict()[name].sum() for s in snapshots) for name in COUNTED}
    weights = scenario.cost.weights._asdict()
    assert all(costs[name] > 0.0 for name in COUNTED if weights[name]), costs
    observed = np.stack([s.transition.observation for s in snapshots])
    assert (observed != 0.0).any(axis=(0, 1)).mean() > 0.8


def test_a_setting_of_the_background_loads(monkeypatch):
    before, drawn = scenario_of(BALANCED), loads.drawn
    add_field(monkeypatch, Background)

    def grown(scenario, exogenous):
        outside, noise = drawn(scenario, exogenous)
        return outside._replace(p_load_kw=outside.p_load_kw * (1.0 + scenario.background.made_up)), noise

    monkeypatch.setattr(loads, "drawn", grown)
    assert_addition_counts(before, altered(before, f"background.{NAME}", 0.5))


@pytest.mark.parametrize("preset", [BALANCED, THREE_PHASE])
@pytest.mark.parametrize("n_env", [1, 3])
def test_a_setting_of_the_cost(preset, n_env, monkeypatch):
    before, deviation = scenario_of(preset), reward.voltage_deviation
    add_field(monkeypatch, Cost)

    def beyond(scenario, v_pu, nodes):
        return np.maximum(deviation(scenario, v_pu, nodes) - scenario.cost.made_up, 0.0)

    monkeypatch.setattr(reward, "voltage_deviation", beyond)
    assert_addition_counts(before, altered(before, f"cost.{NAME}", 0.01))


def test_a_setting_of_the_clock_law(monkeypatch):
    before = scenario_of(BALANCED)
    add_field(monkeypatch, LinearDvfs, 1.0)

    def serve(self, params, f_mhz, work_kw):
        served = np.minimum(params.p_dynamic_kw * (f_mhz / params.f_max_mhz) ** self.made_up, work_kw)
        return served, served

    edit(monkeypatch, LinearDvfs, "serve", serve)
    assert_addition_counts(before, altered(before, f"devices.0.clock_law.{NAME}", 0.5))


def test_a_field_of_a_balanced_feeder(monkeypatch):
    before, solver_for = scenario_of(BALANCED), dynamics.solver_for
    add_field(monkeypatch, Feeder)

    def heavier(feeder, method):
        return lambda feeder, p_kw, *rest: solver_for(feeder, method)(feeder, p_kw * (1.0 + feeder.made_up), *rest)

    monkeypatch.setattr(dynamics, "solver_for", heavier)
    assert_addition_counts(before, altered(before, f"feeder.{NAME}", 0.5))


def test_devices_of_another_kind():
    site = DataCenters(count=3, p_rated_kw=200.0, s_rated_share=1.2, q_max_share=0.5)
    storages = Storages(buses=(18, 33), p_rated_kw=100.0, energy_kwh=200.0)
    scenario = scenario_of(BALANCED, devices=(site, Inverters(), storages))
    assert fast_paths(scenario) == {"grid_pass", "serve_linearly"}
    assert_alike(scenario)


OF_SCENARIO = {
    Scenario: "", Sensing: "sensing", Workload: "workload", Background: "background", Cost: "cost",
    GridControl: "grid_control", RegulatorControl: "grid_control.regulator_settings",
    CapacitorControl: "grid_control.capacitor_settings", GridRequest: "grid_request", LoadProfiles: "load_profiles",
}  # fmt: skip


@pytest.mark.parametrize("n_env", [1, 12])
@pytest.mark.parametrize("kind", OF_SCENARIO, ids=attrgetter("__name__"))
def test_a_field_of_any_part_of_a_scenario(n_env, kind, monkeypatch):
    before = scenario_of(BALANCED)
    add_field(monkeypatch, kind)
    assert "grid_pass" in fast_paths(altered(before), n_env)
    path = f"{OF_SCENARIO[kind]}.{NAME}".removeprefix(".")
    assert fast_paths(altered(before, path, 1.0), n_env) == {"serve_linearly"}


@pytest.mark.parametrize(
    ("kind", "path", "left"),
    [(Feeder, "feeder", "serve_linearly"), (LinearDvfs, "devices.0.clock_law", "grid_pass")],
)
def test_a_field_of_feeder_or_clock_law(kind, path, left, monkeypatch):
    before = scenario_of(BALANCED)
    add_field(monkeypatch, kind)
    assert fast_paths(altered(before, f"{path}.{NAME}", 1.0)) == {left}


@pytest.mark.parametrize("kind", [Exogenous, LoadsToDraw], ids=attrgetter("__name__"))
def test_an_input_of_every_step(kind, monkeypatch):
    before = scenario_of(BALANCED)
    assert "grid_pass" in fast_paths(before)
    monkeypatch.setattr(kind, "_fields", (*kind._fields, NAME))
    assert "grid_pass" not in fast_paths(altered(before))
