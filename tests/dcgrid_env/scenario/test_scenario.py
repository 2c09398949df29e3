"""A scenario: its derived figures, and every refusal with the field, the value and what would do."""

import copy
import dataclasses
import pickle
import re
from operator import attrgetter
from typing import Any

import numpy as np
import pytest

from dcgrid_env import (
    CostWeights,
    Feeder,
    LinearDvfs,
    PrefillDecodeDvfs,
    Scenario,
    ScenarioError,
    load_feeder,
    make_scenario,
)
from dcgrid_env.engine.simulation import Simulation
from dcgrid_env.grid import FeederError


def scenario_of_ones_own(**changes: Any) -> Scenario:
    fields: dict[str, Any] = {
        "name": "mine",
        "feeder": load_feeder("toy6"),
        "source_voltage_pu": 1.02,
        "datacenters.count": 2,
        "datacenters.p_rated_kw": (300.0, 100.0),
        "datacenters.s_rated_share": 1.1,
        "datacenters.q_max_share": 0.5,
        "inverters.buses": (3,),
        "inverters.s_rated_kva": 50.0,
    }
    return Scenario(**fields).replace(**changes)


# --- what follows from the fields ------------------------------------------------------------------


def test_defaults_are_the_designs():
    s = scenario_of_ones_own()
    assert (s.datacenters.idle_share, s.datacenters.f_min_mhz, s.datacenters.f_max_mhz) == (0.23, 210.0, 1410.0)
    assert (s.horizon, s.dt_s, s.split, s.power_flow) == (120, 1.0, "train", "distflow")
    assert (s.background.load_sigma, s.background.load_rho, s.cost.band_pu) == (0.05, 0.9, 0.05)
    assert (s.cost.voltage, s.cost.reward, s.sensing.observe, s.sensing.preview) == ("l1", "shared", "local", True)
    assert (s.sensing.noise_pu, s.sensing.delay_steps, s.background.capacitors) == (0.0, 0, True)
    assert s.cost.weights == (100.0, 1000.0, 0.3, 0.02, 9.0, *[0.0] * 9)
    assert (s.cost.ramp_limit_kw_per_s, s.cost.ramp_window_s, s.cost.voltage_step_limit_pu) == (None, None, None)
    assert s.cost.weights._fields[:5] == ("voltage", "violation", "backlog", "effort", "leftover")
    assert s.cost.weights._fields[5:10] == ("clock", "step", "loss", "unbalance", "switching")
    assert s.cost.weights._fields[10:] == ("ramp_excess", "voltage_step_excess", "overload", "grid_request")
    assert (s.datacenters.phases, s.inverters.phases) == (None, None)
    assert isinstance(s.datacenters.clock_law, LinearDvfs)
    assert s.work_classes == 1
    assert (
        s.datacenters.boost_share,
        s.workload.site_correlation,
        s.workload.compute_share,
        s.workload.recording_split,
    ) == (1.0, 0.0, 1.0, "time")
    assert s.datacenters.buses is None
    assert s.inverters.injection is None


def test_ratings_of_the_devices():
    s = scenario_of_ones_own(
        inverters={"buses": (3, 1), "s_rated_kva": (50.0, 80.0)}, datacenters={"idle_share": 0.2, "f_min_mhz": 300.0}
    )
    dc = s.datacenters.parameters
    np.testing.assert_allclose(dc.p_rated_kw, [300.0, 100.0])
    np.testing.assert_allclose(dc.p_idle_kw, [60.0, 20.0])
    np.testing.assert_allclose(dc.p_dynamic_kw, [240.0, 80.0])
    np.testing.assert_allclose(dc.f_min_mhz, [300.0, 300.0])
    np.testing.assert_allclose(dc.f_max_mhz, [1410.0, 1410.0])
    np.testing.assert_allclose(dc.s_rated_kva, [330.0, 110.0])
    np.testing.assert_allclose(dc.q_max_kvar, [150.0, 50.0])
    np.testing.assert_allclose(s.inverters.parameters.s_rated_kva, [50.0, 80.0])
    np.testing.assert_allclose(
        scenario_of_ones_own(datacenters={"p_rated_kw": 70.0}).datacenters.parameters.p_rated_kw, [70.0, 70.0]
    )


def test_agents_are_slots():
    s = scenario_of_ones_own(inverters={"buses": (3, 1), "s_rated_kva": 50.0})
    assert s.agents == ("dc_0", "dc_1", "inv_0", "inv_1")
    assert (s.n_agents, s.datacenters.count, s.inverters.count) == (4, 2, 2)
    assert scenario_of_ones_own(inverters={"buses": ()}).agents == ("dc_0", "dc_1")
    assert scenario_of_ones_own(n_datacenters=0, datacenters={"p_rated_kw": 1.0}).agents == ("inv_0",)


def test_candidates_are_load_buses_without_a_device():
    # toy6 has load at 2, 3 and 5; the substation and the buses without load are out.
    assert scenario_of_ones_own().candidates.tolist() == [2, 5]
    assert scenario_of_ones_own(
        inverters={"buses": ()}, n_datacenters=3, datacenters={"p_rated_kw": 1.0}
    ).candidates.tolist() == [2, 3, 5]


def test_a_load_at_the_substation_makes_it_no_candidate():
    feeder = Feeder.from_tables(
        name="three", base_kv=1.0, substation="s", v0_pu=1.0, bus_ids=["a", "s", "b"], p_load_kw=[10.0, 10.0, 10.0],
        q_load_kvar=[0.0, 0.0, 0.0], from_bus=["s", "a"], to_bus=["a", "b"], r_ohm=[0.01, 0.01], x_ohm=[0.01, 0.01],
    )  # fmt: skip
    s = scenario_of_ones_own(
        feeder=feeder, inverters={"buses": ("b",)}, n_datacenters=1, datacenters={"p_rated_kw": 5.0}
    )
    assert [feeder.bus_ids[i] for i in s.candidates] == ["a"]


def test_a_scenario_is_frozen():
    s = scenario_of_ones_own()
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(s, "horizon", 5)  # noqa: B010  (the type checker refuses the assignment)


def test_replace_makes_another_and_checks_it():
    s = scenario_of_ones_own()
    other = s.replace(horizon=7, cost={"band_pu": 0.03})
    assert (other.horizon, other.cost.band_pu, other.name) == (7, 0.03, "mine")
    assert (s.horizon, s.cost.band_pu) == (120, 0.05)
    assert other.feeder is s.feeder
    with pytest.raises(ScenarioError, match="horizon is 0"):
        s.replace(horizon=0)


@pytest.mark.parametrize("make", [scenario_of_ones_own, lambda **given: scenario_of_ones_own().replace(**given)])
def test_an_unknown_field_gets_a_suggestion(make):
    with pytest.raises(TypeError) as caught:
        make(horizont=7)
    assert str(caught.value) == "no scenario field 'horizont'; did you mean horizon? `dcgrid list fields` lists all"


def test_a_copy_is_the_scenario_itself():
    s = scenario_of_ones_own()
    assert copy.deepcopy(s) is s
    assert copy.deepcopy({"inside": [s]})["inside"][0] is s


@pytest.mark.parametrize("used", [False, True])
def test_pickle_round_trip(used):
    s = make_scenario("ieee33-weak", horizon=4)
    if used:  # with everything that is remembered along the way
        assert s.datacenters.parameters
        assert s.inverters.parameters
        assert s.agents
        assert len(s.candidates)
    other = pickle.loads(pickle.dumps(s))
    for field in dataclasses.fields(Scenario):
        if field.name != "feeder":
            assert getattr(other, field.name) == getattr(s, field.name)
    assert other.feeder.bus_ids == s.feeder.bus_ids
    np.testing.assert_array_equal(other.feeder.r_ohm, s.feeder.r_ohm)
    np.testing.assert_array_equal(other.candidates, s.candidates)
    trajectories = []
    for scenario in (s, other):
        simulation = Simulation(scenario, 2)
        simulation.reset([3, 4])
        trajectories.append(simulation.step(np.full((2, 10), 0.3)))
    np.testing.assert_array_equal(trajectories[0].observation, trajectories[1].observation)
    np.testing.assert_array_equal(trajectories[0].reward, trajectories[1].reward)


# --- refusals --------------------------------------------------------------------------------------

RANGES = {
    # field: values that will not do, and the range that the message must name
    "source_voltage_pu": ((0.4, 1.6, -1.0, "1"), "0.5, 1.5"),
    "datacenters.idle_share": ((-0.01, 1.0), "0, 0.99"),
    "datacenters.s_rated_share": ((0.99, float("inf"), None), "1, 1e+06"),
    "datacenters.q_max_share": ((-0.1, 1.11), "0, s_rated_share = 1.1"),
    "datacenters.f_min_mhz": ((0.0, -1.0, 1411.0), "1e-09, f_max_mhz = 1410"),
    "datacenters.f_max_mhz": ((float("inf"),), "1e-09, 1e+06"),
    "datacenters.boost_share": ((0.99, 2.1, None), "1, 2"),
    "workload.site_correlation": ((-0.1, 1.1), "0, 1"),
    "workload.compute_share": ((-0.1, 1.1, True), "0, 1"),
    "background.load_sigma": ((-0.01, 0.31), "0, 0.3"),
    "background.load_rho": ((-0.1, 1.5), "0, 0.999999"),
    "sensing.noise_pu": ((-0.001, 2.0), "0, 1"),
    "dt_s": ((0.0, -1.0, 1e-4, 3601.0), "0.001, 3600"),
    "cost.band_pu": ((-0.05, 1.5), "0, 1"),
}
OUT_OF_RANGE = [(field, value, text) for field, (values, text) in RANGES.items() for value in values]


@pytest.mark.parametrize(("field", "value", "text"), OUT_OF_RANGE)
def test_a_number_out_of_range_is_refused(field, value, text):
    wanted = f"scenario 'mine': {field} is {value!r}; give a finite number in [{text}]"
    with pytest.raises(ScenarioError, match=f"^{re.escape(wanted)}$"):
        scenario_of_ones_own(**{field: value})


@pytest.mark.parametrize("field", sorted(set(RANGES) - {"datacenters.f_max_mhz"}))
def test_not_a_number_is_refused(field):
    with pytest.raises(ScenarioError, match=f"'mine': {field} is nan; give a finite number"):
        scenario_of_ones_own(**{field: float("nan")})


def test_a_load_that_never_changes_is_refused():
    with pytest.raises(ScenarioError, match=r"'mine': background.load_rho is 1\.0; give a finite number"):
        scenario_of_ones_own(background={"load_rho": 1.0})  # the noise would have no stationary state of its own


@pytest.mark.parametrize(
    "field",
    ["source_voltage_pu", "background.load_sigma", "dt_s", "cost.band_pu", "datacenters.idle_share"],
)
def test_the_ends_of_a_range_will_do(field):
    ends = {
        "source_voltage_pu": (0.5, 1.5),
        "background.load_sigma": (0, 0.3),
        "dt_s": (1e-3, 3600),
        "cost.band_pu": (0, 1),
        "datacenters.idle_share": (0, 0.99),
    }
    for value in ends[field]:
        assert attrgetter(field)(scenario_of_ones_own(**{field: value})) == value


@pytest.mark.parametrize(
    ("field", "value", "low"),
    [
        ("datacenters.count", -1, 0), ("datacenters.count", 1.5, 0), ("datacenters.count", "2", 0),
        ("datacenters.count", True, 0),
        ("horizon", 0, 1), ("horizon", 120.0, 1), ("horizon", None, 1), ("horizon", True, 1),
        ("sensing.delay_steps", -1, 0), ("sensing.delay_steps", 0.5, 0),
    ],
)  # fmt: skip
def test_what_is_no_count_is_refused(field, value, low):
    wanted = rf"scenario 'mine': {field} is {value!r}; give a whole number of at least {low}"
    with pytest.raises(ScenarioError, match=wanted):
        scenario_of_ones_own(**{field: value})


def test_a_numpy_integer_is_a_count():
    assert scenario_of_ones_own(horizon=np.int64(5)).horizon == 5


@pytest.mark.parametrize(
    ("field", "choices"),
    [
        ("power_flow", ["distflow", "lindistflow", "sweep"]),
        ("cost.voltage", ["l1", "l2", "bowl", "courant_beltrami", "bump"]),
        ("cost.reward", ["shared", "local", "difference"]),
        ("sensing.observe", ["local", "neighbours", "feeder"]),
        ("workload.window", ["random", "start", "together"]),
        ("workload.recording_split", ["time", "recording"]),
        ("split", ["train", "validation", "test", "ood", "whole"]),
    ],
)
def test_an_unknown_choice_lists_those_there_are(field, choices):
    for choice in [choice for choice in choices if choice != "sweep"]:  # of three-phase feeders
        assert attrgetter(field)(scenario_of_ones_own(**{field: choice})) == choice
    for value in ("other", None, 1):
        wanted = rf"scenario 'mine': {field} is {value!r}; choose one of {', '.join(choices)}$"
        with pytest.raises(ScenarioError, match=wanted):
            scenario_of_ones_own(**{field: value})


@pytest.mark.parametrize("field", CostWeights._fields)
@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf"), None, "1"])
def test_a_weight_that_cannot_be_is_refused(field, value):
    with pytest.raises(ScenarioError, match=rf"'mine': cost.weights\.{field} is {value!r}; give a finite number >= 0"):
        scenario_of_ones_own(weights=CostWeights()._replace(**{field: value}))


@pytest.mark.parametrize("name", ["unbalance", "switching"])
def test_a_term_that_a_balanced_feeder_does_not_have_is_refused(name):
    with pytest.raises(
        ScenarioError, match=rf"'mine': cost.weights\.{name} is 2\.0; set it to 0: the balanced feeder 'toy6'"
    ):
        scenario_of_ones_own(weights={name: 2.0})


@pytest.mark.parametrize("field", ["datacenters.p_rated_kw", "inverters.s_rated_kva"])
@pytest.mark.parametrize("value", [0.0, -5.0, float("nan"), float("inf"), (), (1.0, 2.0, 3.0), (1.0, 0.0), (1.0, -2.0)])
def test_ratings_that_cannot_be_are_refused(field, value):
    with pytest.raises(
        ScenarioError,
        match=rf"'mine': {field} is .*; give one positive number of at most 1e\+09, or one for each of",
    ):
        scenario_of_ones_own(**{"inverters.buses": (3, 1)}, **{field: value})


class _ThreeClasses(LinearDvfs):
    work_classes = 3

    def __repr__(self) -> str:
        return "three"


class _NobodysLaw:
    """A custom law that does not define work classes."""

    def serve(self, params, f_mhz, work_kw):
        return work_kw, work_kw


def test_a_clock_law_has_one_work_class_or_two():
    assert scenario_of_ones_own(datacenters={"clock_law": _NobodysLaw()}).work_classes == 1
    assert scenario_of_ones_own(datacenters={"clock_law": PrefillDecodeDvfs()}).work_classes == 2
    with pytest.raises(
        ScenarioError, match=r"'mine': datacenters.clock_law is three; give a clock law of 1 or 2 work classes, not 3"
    ):
        scenario_of_ones_own(datacenters={"clock_law": _ThreeClasses()})
    with pytest.raises(
        ScenarioError,
        match=r"datacenters.clock_law is 'fast'; give 'linear', 'prefill-decode', 'power-cap', or a mapping",
    ):
        scenario_of_ones_own(datacenters={"clock_law": "fast"})


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"horizon": 10**5000}, "horizon is a number of more than 4300 digits; give a whole number"),
        ({"cost": {"band_pu": 10**5000}}, "band_pu is a number of more than 4300 digits; give"),
        ({"datacenters": {"buses": np.array("18")}}, "datacenters.buses is '18'; give both"),
    ],
)
def test_values_that_python_cannot_write_or_measure_are_refused_by_name(overrides, message):
    with pytest.raises(ScenarioError, match=message):
        make_scenario("ieee33-weak", **overrides)


def test_the_order_of_devices_is_a_difference():
    s = make_scenario("ieee33-weak")
    assert s.difference(s.replace(devices=s.devices[::-1])) == "devices"


def test_clock_laws_are_told_apart():
    s = scenario_of_ones_own(datacenters={"clock_law": PrefillDecodeDvfs()})
    assert s.difference(scenario_of_ones_own(datacenters={"clock_law": PrefillDecodeDvfs()})) is None
    assert (
        s.difference(scenario_of_ones_own(datacenters={"clock_law": PrefillDecodeDvfs(decode_clock_share=0.1)}))
        == "datacenters.clock_law"
    )
    assert s.difference(scenario_of_ones_own()) == "datacenters.clock_law"
    assert pickle.loads(pickle.dumps(s)).datacenters.clock_law == PrefillDecodeDvfs()


def test_a_feeder_must_be_one():
    with pytest.raises(ScenarioError, match=r"'mine': feeder is 6; give a feeder, load_feeder\(name\)"):
        scenario_of_ones_own(feeder=6)
    with pytest.raises(FeederError, match=r"no feeder 'no/such'; `dcgrid list feeders` lists all; or give a folder"):
        scenario_of_ones_own(feeder="no/such")


@pytest.mark.parametrize("field", ["inverters.buses", "datacenters.buses"])
def test_an_unknown_bus_lists_those_there_are(field):
    buses = (77,) if field == "inverters.buses" else (2, 77)
    with pytest.raises(ScenarioError, match=r"'mine'.*no bus '77'; its buses are \['0', '1', '2', '3', '4', '5'\]"):
        scenario_of_ones_own(**{field: buses})


@pytest.mark.parametrize("field", ["inverters.buses", "datacenters.buses"])
def test_no_device_at_the_substation(field):
    buses = (0,) if field == "inverters.buses" else (2, 0)
    with pytest.raises(ScenarioError, match=r"'mine'.*buses has the substation '0'"):
        scenario_of_ones_own(**{field: buses})


@pytest.mark.parametrize(
    "changes", [{"datacenters.buses": (2, 2)}, {"datacenters.buses": (2, 3)}, {"inverters.buses": (4, 4)}]
)
def test_one_device_a_bus(changes):
    bus = {"(2, 2)": 2, "(2, 3)": 3, "(4, 4)": 4}[str(next(iter(changes.values())))]
    with pytest.raises(ScenarioError, match=rf"buses has '{bus}', where another device is; give each its own"):
        scenario_of_ones_own(**changes)


def test_as_many_buses_as_datacenters():
    with pytest.raises(ScenarioError, match=r"datacenters.count is 2, but datacenters.buses is \('2',\); give"):
        scenario_of_ones_own(datacenters={"count": 2, "buses": (2,)})


def test_the_number_of_sites_follows_from_their_buses():
    for buses in ((18,), [18, "25"], (18, 33, 25, 22, 12)):
        scenario = make_scenario("ieee33", datacenters={"buses": buses})
        assert scenario.datacenters.count == len(buses)
        assert scenario.datacenters.buses == tuple(map(str, buses))
        assert (
            make_scenario("ieee33", n_datacenters=len(buses), datacenters={"buses": buses}).difference(scenario) is None
        )
    fields = {
        "kind": "datacenter",
        "buses": [18, 25],
        "p_rated_kw": 500.0,
        "s_rated_share": 1.1,
        "q_max_share": 0.33,
    }
    listed = make_scenario("ieee33", devices=[fields])
    assert (listed.datacenters.count, listed.datacenters.buses) == (2, ("18", "25"))
    assert make_scenario("ieee33", n_datacenters=2, datacenters={"buses": None}).datacenters.count == 2
    assert make_scenario("ieee33", inverters={"buses": (3, 7)}).inverters.count == 2
    for changes in ({"n_datacenters": 3, "datacenters.buses": (18, 25)}, {"n_datacenters": 3}):
        with pytest.raises(ScenarioError, match=r"datacenters\.count is 3, but datacenters.buses is .*; give both"):
            make_scenario("ieee33", **changes)


def test_no_more_datacenters_than_free_load_buses():
    with pytest.raises(ScenarioError, match=r"datacenters\.count is 3; only 2 load buses have no device"):
        scenario_of_ones_own(n_datacenters=3, datacenters={"p_rated_kw": 1.0})


def test_somebody_must_act():
    with pytest.raises(ScenarioError, match="'mine': devices are none, hence there is no agent"):
        scenario_of_ones_own(n_datacenters=0, datacenters={"p_rated_kw": 1.0}, inverters={"buses": ()})


def test_a_refusal_is_a_value_error():
    with pytest.raises(ValueError, match="horizon"):
        scenario_of_ones_own(horizon=0)


def test_nobody_who_is_handed_a_scenario_can_change_its_ratings():
    s = make_scenario("fault")
    for array in (
        *s.datacenters.parameters,
        *s.inverters.parameters,
        s.q_scale_kvar,
        s.candidates,
        *s.fault_targets,
        s.feeder.r_ohm,
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
