"""Fast paths give the results of the general path, also where a contributor has added to what they know.

Each test of an addition does what docs/architecture.md says. It adds a field with a default to a class and uses it in
the general path, or it adds a record to a list of cost terms or observation fields.
"""

from __future__ import annotations

from dataclasses import is_dataclass
from functools import wraps
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.devices import DataCenters, Inverters, Storages
from dcgrid_env.devices.capacitor_bank.capacitor_control import CapacitorControl
from dcgrid_env.devices.datacenter import data_centers
from dcgrid_env.devices.datacenter.clock_law import LinearDvfs
from dcgrid_env.devices.datacenter.datacenter import DataCenterState
from dcgrid_env.devices.datacenter.site_features import PassesBy
from dcgrid_env.devices.tap_changer.regulator_control import RegulatorControl
from dcgrid_env.engine import plain_step
from dcgrid_env.engine.cost import observation, plain_figures, reward
from dcgrid_env.engine.cost.observation import ObservationField
from dcgrid_env.engine.exogenous.episode import Episode
from dcgrid_env.engine.physics import dynamics, equipment, grid_pass, loads, phase_pass
from dcgrid_env.engine.physics.connections import Placement
from dcgrid_env.engine.physics.state import Exogenous, LoadsToDraw, State
from dcgrid_env.engine.simulation import Simulation
from dcgrid_env.engine.snapshot import Transition
from dcgrid_env.grid import Feeder, ThreePhaseFeeder
from dcgrid_env.grid.network import Network, NodeTable, RegulatorTable, SourceTable
from dcgrid_env.scenario.background import Background
from dcgrid_env.scenario.cost import Cost, CostWeights
from dcgrid_env.scenario.costs.grid_terms import TERMS, GridTerm
from dcgrid_env.scenario.grid_control import GridControl
from dcgrid_env.scenario.grid_request import GridRequest
from dcgrid_env.scenario.load_profiles import LoadProfiles
from dcgrid_env.scenario.presets import PRESETS
from dcgrid_env.scenario.scenario import Scenario
from dcgrid_env.scenario.sensing import Sensing
from dcgrid_env.scenario.workload import Workload
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


PLAIN = "toy6 ieee123 ieee33-weak ieee33 das69 khodr141 bursty sync training mixed wrong-model scale-32"
FAST = {
    plain_step: PLAIN,
    grid_pass: f"{PLAIN} robust late-measurements ieee33-weak-ups smoothing routing load-target",
    plain_figures: """
        ieee13-3ph ieee34-3ph ieee123-3ph ieee13-3ph-published ieee34-3ph-published ieee123-3ph-published
    """,
    phase_pass: """
        ieee13-3ph ieee34-3ph ieee123-3ph ieee13-3ph-published ieee34-3ph-published ieee123-3ph-published ride-through
    """,
}
"""Presets that each fast path is for."""


@pytest.mark.slow
@pytest.mark.parametrize("path", FAST, ids=attrgetter("__name__"))
def test_presets_take_their_fast_paths(path):
    fitting = {name for name in PRESETS if path.fits(make_scenario(name), *((1,) if path is plain_step else ()))}
    assert fitting == set(FAST[path].split())


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
        ("ieee13-3ph", 1, {"sensing": {"noise_pu": 0.003, "delay_steps": 1}, "inverters": {"injection": "pv"}}),
        ("ieee13-3ph", 1, {"grid_control": {"regulator_settings": {"timer": "reset", "offset_v": 2.0}}}),
        ("ride-through", 1, {}),
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


@pytest.mark.parametrize("preset", [BALANCED, THREE_PHASE])
@pytest.mark.parametrize("place", [0, 3, 99])
@pytest.mark.parametrize("is_flagged", [True, False], ids=["flag", "always"])
def test_an_observation_field(preset, place, is_flagged, monkeypatch):
    before = scenario_of(preset)
    add_field(monkeypatch, Sensing, False)
    after = altered(before, f"sensing.{NAME}", is_flagged)
    assert_alike(before)
    field = ObservationField(
        NAME, "kvar", lambda seen: 0.5 * seen.state.q_kvar + 3.0, lambda _: 0.01, lambda _: (-1e3, 1e3),
        (lambda scenario: scenario.sensing.made_up) if is_flagged else lambda _: True,
    )  # fmt: skip
    fields = observation.FIELDS
    monkeypatch.setattr(observation, "FIELDS", (*fields[:place], field, *fields[place:]))
    observed = [snapshot.transition.observation for snapshot in assert_alike(after)]
    assert observed[0].shape[1] == Simulation(before, 1).reset([0]).observation.shape[1] + after.n_agents
    assert all(np.isfinite(row).all() for row in observed)


@pytest.mark.parametrize("preset", [BALANCED, THREE_PHASE])
def test_a_field_in_the_place_of_another(preset, monkeypatch):
    before = scenario_of(preset)
    assert_alike(before)
    other = [
        field._replace(name=NAME, raw=lambda seen: 0.5 * seen.state.q_kvar) if field.name == "p" else field
        for field in observation.FIELDS
    ]
    monkeypatch.setattr(observation, "FIELDS", tuple(other))
    assert_alike(altered(before))


@pytest.mark.parametrize("preset", [BALANCED, THREE_PHASE])
def test_an_exponent_of_the_delay_cost_of_data_centres(preset, monkeypatch):
    before, amount = scenario_of(preset), DataCenters.amount
    add_field(monkeypatch, DataCenters, 1.0)

    def charged(self, name, parameters, state):
        found = amount(self, name, parameters, state)
        return found**self.made_up if name == "backlog_kws" else found

    edit(monkeypatch, DataCenters, "amount", charged)
    assert_addition_counts(before, altered(before, f"devices.0.{NAME}", 1.5))


@pytest.mark.parametrize("preset", [BALANCED, THREE_PHASE])
def test_another_amount_of_a_cost_term_of_data_centres(preset, monkeypatch):
    before, amount, cost_terms = scenario_of(preset), DataCenters.amount, DataCenters.cost_terms
    assert_alike(before)

    def charged(self, name, parameters, state):
        return 2.0 * state.backlog_kws if name == NAME else amount(self, name, parameters, state)

    def terms(self, horizon, dt_s):
        first, *rest = cost_terms(self, horizon, dt_s)
        return first._replace(amount=NAME), *rest

    edit(monkeypatch, DataCenters, "amount", charged)
    edit(monkeypatch, DataCenters, "cost_terms", terms)
    assert_alike(altered(before))


@pytest.mark.parametrize("preset", [BALANCED, THREE_PHASE])
@pytest.mark.parametrize("is_listed", [True, False])
def test_a_cost_term_of_the_grid(preset, is_listed, monkeypatch):
    before = scenario_of(preset)
    term = GridTerm(
        NAME, "made-up cost", "mean square of the voltage", is_always_listed=is_listed,
        amount=lambda step: (step.state.v_pu**2).sum(-1), divisor=lambda step: step.n_nodes,
    )  # fmt: skip
    assert_alike(before)
    monkeypatch.setattr(reward, "TERMS", (*TERMS, term))
    weights = before.cost.weights

    class Weights(CostWeights):
        _fields = (*CostWeights._fields, NAME)
        made_up = 2.0

        def _asdict(self):
            return super()._asdict() | {NAME: self.made_up}

    after = altered(before, "cost.weights", Weights(*weights))
    costs = assert_alike(after)[-1].transition.costs
    assert costs.made_up[0] > 1.9


@pytest.mark.parametrize("preset", [BALANCED, THREE_PHASE])
def test_a_setting_of_the_background_loads(preset, monkeypatch):
    before, drawn = scenario_of(preset), loads.drawn
    add_field(monkeypatch, Background)

    def grown(scenario, exogenous):
        outside, noise = drawn(scenario, exogenous)
        return outside._replace(p_load_kw=outside.p_load_kw * (1.0 + scenario.background.made_up)), noise

    monkeypatch.setattr(loads, "drawn", grown)
    assert_addition_counts(before, altered(before, f"background.{NAME}", 0.5))


@pytest.mark.parametrize("preset", [BALANCED, THREE_PHASE])
def test_a_setting_of_the_workload(preset, monkeypatch):
    before, inputs = scenario_of(preset), dynamics._given
    add_field(monkeypatch, Workload)

    def scaled(scenario, i, exogenous):
        found = inputs(scenario, i, exogenous)
        if scenario.devices[i].input != "workload":
            return found
        return found._replace(p_ref_kw=found.p_ref_kw * (1.0 - scenario.workload.made_up))

    monkeypatch.setattr(dynamics, "_given", scaled)
    assert_addition_counts(before, altered(before, f"workload.{NAME}", 0.5))


@pytest.mark.parametrize("preset", [BALANCED, THREE_PHASE])
@pytest.mark.parametrize("n_env", [1, 3])
def test_a_setting_of_the_cost(preset, n_env, monkeypatch):
    before, deviation = scenario_of(preset), reward.voltage_deviation
    add_field(monkeypatch, Cost)

    def beyond(scenario, v_pu, nodes):
        return np.maximum(deviation(scenario, v_pu, nodes) - scenario.cost.made_up, 0.0)

    monkeypatch.setattr(reward, "voltage_deviation", beyond)
    assert_addition_counts(before, altered(before, f"cost.{NAME}", 0.01))


@pytest.mark.parametrize("preset", [BALANCED, THREE_PHASE])
def test_a_setting_of_inverters(preset, monkeypatch):
    before, step = scenario_of(preset, inverters={"injection": "pv"}), Inverters.step
    add_field(monkeypatch, Inverters)

    def derated(self, parameters, state, setpoints, given, dt_s):
        after, p_kw = step(self, parameters, state, setpoints, given, dt_s)
        return after, (1.0 - self.made_up) * p_kw

    edit(monkeypatch, Inverters, "step", derated)
    assert_addition_counts(before, altered(before, f"devices.1.{NAME}", 0.5))


@pytest.mark.parametrize("preset", [BALANCED, THREE_PHASE])
def test_a_setting_of_the_clock_law(preset, monkeypatch):
    before = scenario_of(preset)
    add_field(monkeypatch, LinearDvfs, 1.0)

    def serve(self, params, f_mhz, work_kw):
        served = np.minimum(params.p_dynamic_kw * (f_mhz / params.f_max_mhz) ** self.made_up, work_kw)
        return served, served

    edit(monkeypatch, LinearDvfs, "serve", serve)
    assert_addition_counts(before, altered(before, f"devices.0.clock_law.{NAME}", 0.5))


class _Fan(PassesBy):
    """A feature of sites: a fan with a constant draw, observed and charged."""

    amounts = ("fan_kw",)

    def fields(self, params, horizon, dt_s):
        return (observation.Field("fan", "kW", 0.0, 10.0, np.ones_like(params.p_rated_kw)),)

    def cost_terms(self, params, horizon, dt_s):
        return (reward.CostTerm("fan", "fan_kw", np.ones_like(params.p_rated_kw), 1.0, 10.0, weight=0.1),)

    def initial(self, params, zero):
        return _FanState(zero + 3.0)

    def step(self, params, feature_state, site, p_kw, setpoints, given, dt_s):
        return feature_state, site, p_kw + feature_state.fan_kw

    def observe(self, params, feature_state):
        return (feature_state.fan_kw,)

    def amount(self, name, params, feature_state):
        return feature_state.fan_kw

    def totals(self, feature_state):
        return {}


class _FanState(NamedTuple):
    fan_kw: Any


@pytest.mark.parametrize("preset", [BALANCED, THREE_PHASE])
def test_a_feature_of_sites(preset, monkeypatch):
    before, features_of = scenario_of(preset), data_centers.features_of
    add_field(monkeypatch, DataCenters, None)
    monkeypatch.setattr(
        data_centers, "features_of", lambda sites: (*features_of(sites), *([_Fan()] if sites.made_up else []))
    )
    assert_addition_counts(before, altered(before, f"devices.0.{NAME}", "fan"))


def test_a_field_of_a_balanced_feeder(monkeypatch):
    before, solver_for = scenario_of(BALANCED), dynamics.solver_for
    add_field(monkeypatch, Feeder)

    def heavier(feeder, method):
        return lambda feeder, p_kw, *rest: solver_for(feeder, method)(feeder, p_kw * (1.0 + feeder.made_up), *rest)

    monkeypatch.setattr(dynamics, "solver_for", heavier)
    assert_addition_counts(before, altered(before, f"feeder.{NAME}", 0.5))


def test_a_column_of_regulators(monkeypatch):
    before, tap_ratio = scenario_of(THREE_PHASE), ThreePhaseFeeder.tap_ratio
    add_field(monkeypatch, RegulatorTable)
    edit(
        monkeypatch,
        ThreePhaseFeeder,
        "tap_ratio",
        lambda self, tap: tap_ratio(self, tap) + self.network.regulator.made_up,
    )
    assert_addition_counts(before, altered(before, f"feeder.network.regulator.{NAME}", 0.01))


@pytest.mark.parametrize(
    ("kind", "path"),
    [(GridControl, "grid_control"), (RegulatorControl, "grid_control.regulator_settings")],
)
def test_a_setting_of_the_control_of_regulators(kind, path, monkeypatch):
    before, measured = scenario_of(THREE_PHASE, dt_s=1.0), equipment.measured  # steps in which no control acts
    add_field(monkeypatch, kind)

    def with_error(scenario, of_feeder, solution):
        found, error_v = measured(scenario, of_feeder, solution), attrgetter(path)(scenario).made_up
        return found._replace(regulators=found.regulators._replace(relay_v=found.regulators.relay_v + error_v))

    monkeypatch.setattr(equipment, "measured", with_error)
    assert_addition_counts(before, altered(before, f"{path}.{NAME}", 0.5))


def _twice(name):
    """A method that gives twice what a class gives, as a subclass or a program might have it."""

    def method(self, *given):
        found = getattr(type(self).__mro__[1], name)(self, *given)
        if name == "step":
            return found[0], 2.0 * found[1]
        return tuple(2.0 * figure for figure in found) if isinstance(found, tuple) else 2.0 * found

    return method


@pytest.mark.parametrize("preset", [BALANCED, THREE_PHASE])
@pytest.mark.parametrize(
    ("place", "kind", "name"),
    [(0, DataCenters, "step"), (0, DataCenters, "amount"), (0, DataCenters, "observe"), (1, Inverters, "step")],
)
def test_a_subclass_of_devices(preset, place, kind, name):
    before = scenario_of(preset, inverters={"injection": "pv"})
    after = altered(before)
    group = altered(before.devices[place])
    object.__setattr__(group, "__class__", type(f"Own{kind.__name__}", (kind,), {name: _twice(name)}))
    devices = tuple(group if i == place else device for i, device in enumerate(before.devices))
    object.__setattr__(after, "devices", devices)
    assert_addition_counts(before, after)


@pytest.mark.parametrize("preset", [BALANCED, THREE_PHASE])
@pytest.mark.parametrize("name", ["step", "amount", "observe"])
def test_a_method_of_data_centres_that_a_program_replaces(preset, name, monkeypatch):
    before, method = scenario_of(preset), getattr(DataCenters, name)
    assert_alike(before)

    @wraps(method)
    def changed(self, *given):
        found = method(self, *given)
        if name == "step":
            return found[0], 2.0 * found[1]
        return tuple(2.0 * figure for figure in found) if isinstance(found, tuple) else 2.0 * found

    monkeypatch.setattr(DataCenters, name, changed)
    assert_alike(altered(before))


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
TABLES = {
    type(table): f"network.{name}"
    for name, table in vars(Network("", SourceTable(), NodeTable())).items()
    if is_dataclass(table)
}
OF_FEEDERS = {
    BALANCED: {Feeder: ""},
    THREE_PHASE: {ThreePhaseFeeder: "", Network: "network", **TABLES},
}


def assert_general_path(before: Any, after: Any, n_env: int, allowed: set[str]) -> None:
    """No fast path is taken but those in ``allowed``, whereas some are taken before."""
    assert fast_paths(before, n_env) - allowed
    assert fast_paths(after, n_env) <= allowed


@pytest.mark.parametrize("preset", [BALANCED, THREE_PHASE])
@pytest.mark.parametrize("n_env", [1, 12])
@pytest.mark.parametrize("kind", OF_SCENARIO, ids=attrgetter("__name__"))
def test_a_field_of_any_part_of_a_scenario(preset, n_env, kind, monkeypatch):
    before = scenario_of(preset)
    add_field(monkeypatch, kind)
    assert fast_paths(altered(before), n_env) == fast_paths(before, n_env)
    path = f"{OF_SCENARIO[kind]}.{NAME}".removeprefix(".")
    assert_general_path(before, altered(before, path, 1.0), n_env, {"serve_linearly"})


@pytest.mark.parametrize(
    ("preset", "kind", "path"),
    [(preset, kind, path) for preset, kinds in OF_FEEDERS.items() for kind, path in kinds.items()],
)
def test_a_field_of_any_table_of_a_feeder(preset, kind, path, monkeypatch):
    before = scenario_of(preset)
    add_field(monkeypatch, kind)
    after = altered(before, ".".join(filter(None, ("feeder", path, NAME))), 1.0)
    assert_general_path(before, after, 1, {"serve_linearly", "plain_figures"})


@pytest.mark.parametrize("preset", [BALANCED, THREE_PHASE])
@pytest.mark.parametrize(
    ("kind", "path"),
    [(DataCenters, "devices.0"), (Inverters, "devices.1"), (LinearDvfs, "devices.0.clock_law")],
    ids=["DataCenters", "Inverters", "LinearDvfs"],
)
def test_a_field_of_any_device(preset, kind, path, monkeypatch):
    before = scenario_of(preset)
    add_field(monkeypatch, kind)
    after = altered(before, f"{path}.{NAME}", 1.0)
    allowed = {"grid_pass", "phase_pass"} | ({"serve_linearly"} if kind is not LinearDvfs else set())
    assert_general_path(before, after, 1, allowed)


@pytest.mark.parametrize(
    "kind",
    [State, Exogenous, LoadsToDraw, Transition, DataCenterState, Episode, Placement],
    ids=attrgetter("__name__"),
)
def test_an_array_of_every_step(kind, monkeypatch):
    before = scenario_of(BALANCED)
    assert "plain_step" in fast_paths(before)
    monkeypatch.setattr(kind, "_fields", (*kind._fields, NAME))
    assert "plain_step" not in fast_paths(before)
