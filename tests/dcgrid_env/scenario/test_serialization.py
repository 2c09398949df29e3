"""Every field of a scenario as plain data, through JSON and back."""

import dataclasses
import json
import pickle
from operator import attrgetter
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

from dcgrid_env import (
    CostWeights,
    Fault,
    Feeder,
    LinearDvfs,
    PrefillDecodeDvfs,
    Scenario,
    ScenarioError,
    load_feeder,
    make_scenario,
    scenario_hash,
)
from dcgrid_env.grid import FeederError
from dcgrid_env.scenario.assembly import ALIASES, FORMER, PARTS
from dcgrid_env.scenario.serialization import to_data
from dcgrid_env.traces import PowerTrace, generate_inference
from helpers.three_phase import ieee13

FAULT = {"among": ["inverter", "dc_0"], "begin_s": [1.0, 2.0], "duration_s": [3.0, float("inf")]}
PLAIN = {
    "name": "mine",
    "feeder": "das69",
    "source_voltage_pu": 1.02,
    "background.capacitors": False,
    "n_datacenters": 2,
    "datacenters.buses": [10, 22, 32],
    "datacenters.p_rated_kw": [100.0, 200, 300.0],
    "datacenters.idle_share": 0.3,
    "datacenters.f_min_mhz": 300,
    "datacenters.f_max_mhz": 1400.0,
    "datacenters.s_rated_share": 1.2,
    "datacenters.q_max_share": 0.2,
    "datacenters.clock_law": {"law": "prefill-decode", "decode_clock_share": 0.03},
    "datacenters.boost_share": 1.1,
    "inverters.buses": [4, 5],
    "inverters.s_rated_kva": [10.0, 20.0, 30.0, 40.0],
    "inverters.injection": [0.5] * 121,
    "faults": [{**FAULT, "duration_s": [3.0, 9.0]}, FAULT | {"duration_s": [float("inf")] * 2}],
    "datacenters.ride_through": {"curve": "itic", "release": "agent"},
    "datacenters.storage": {"p_rated_kw": [300.0, 200.0, 100.0], "energy_kwh": 5.0},
    "datacenters.smoothing": {"floor_share": 0.4},
    "datacenters.cooling": {"cooling_share": 0.2},
    "datacenters.routing": {"movable_share": 0.5},
    "datacenters.batching": {"reference": 128.0},
    "datacenters.service": {"deadline_s": 40.0, "order": "fcfs"},
    "inverters.ride_through": {"curve": {"under": [[0.88, 5.0]], "over": [[1.1, 2.0], [1.2, 0.16]]}},
    "sags": [{"begin_s": [1.0, 2.0], "duration_s": [0.05, 0.06], "retained_pu": [0.3, 0.4]}],
    "trace": "training",
    "workload.recording_split": "recording",
    "workload.window": "together",
    "workload.site_correlation": 0.5,
    "workload.compute_share": 0.5,
    "workload.full_load_s": [2.0, 5.0],
    "workload.trace_scale": "as-recorded",
    "background.load_sigma": 0.1,
    "background.load_rho": 0.5,
    "sensing.noise_pu": 0.001,
    "sensing.delay_steps": 2,
    "background.start_hour": 6.5,
    "horizon": 60,
    "dt_s": 2.0,
    "power_flow": "lindistflow",
    "split": "test",
    "weights": {"backlog": 1, "loss": 0.5},
    "cost.band_pu": 0.03,
    "cost.voltage": "l2",
    "reward": "local",
    "cost.ramp_limit_kw_per_s": 100,
    "cost.ramp_window_s": 5.0,
    "cost.voltage_step_limit_pu": 0.02,
    "observe": "neighbours",
    "sensing.preview": False,
    "sensing.loading": True,
    "sensing.r_model_share": 0.9,
    "sensing.x_model_share": 1.1,
}
"""A plain value of every field, other than that of ieee33-weak."""
OF_THREE_PHASES = {
    "datacenters.phases": ["abc", "ab"],
    "inverters.phases": ["b", "abc", "c", "a"],
    "grid_control.regulators": {"reg1": "agent"},
    "grid_control.capacitors": {"cap2": "controlled"},
    "grid_control.capacitor_settings": {"on_below_pu": 0.96},
}
"""A plain value of every field that a three-phase feeder alone has, other than that of ``ieee13``."""
WITH = {
    "n_datacenters": {"datacenters.buses": None},
    "feeder": {"datacenters.buses": [27, 65, 35]},
    "workload.recording_split": {},
    "workload.trace_scale": {"trace": str(Path(__file__).parent / "recording.csv")},
    "cost.ramp_window_s": {"cost.ramp_limit_kw_per_s": 100.0},
    "sags": {"datacenters.ride_through": "itic"},
    "sensing.loading": {"feeder": str(Path(__file__).parent / "rated_feeder")},
}
"""What a field's value needs besides."""


def test_every_field_has_its_plain_value_here():
    own = {field.name for field in dataclasses.fields(Scenario)} - {*PARTS, "devices"}
    assert set(PLAIN) | set(OF_THREE_PHASES) == own | set(ALIASES) | set(FORMER.values()) - {"source_voltage_pu"} | own


@pytest.mark.parametrize("name", OF_THREE_PHASES)
def test_a_field_of_three_phases_goes_through_json_and_back(name):
    base, overrides = ieee13(), {name: OF_THREE_PHASES[name]}
    scenario = base.replace(**overrides)
    assert scenario.difference(base) is not None
    assert scenario.difference(base.replace(**json.loads(json.dumps(overrides)))) is None
    again = json.loads(json.dumps({name: to_data(attrgetter(ALIASES.get(name) or name)(scenario))}))
    assert scenario.difference(base.replace(**again)) is None


@pytest.mark.parametrize("name", PLAIN)
def test_a_field_goes_through_json_and_back(name):
    overrides = {name: PLAIN[name], **WITH.get(name, {})}
    scenario = make_scenario("ieee33-weak", **overrides)
    assert scenario.difference(make_scenario("ieee33-weak")) is not None
    assert scenario.difference(make_scenario("ieee33-weak", **json.loads(json.dumps(overrides)))) is None
    again = json.loads(json.dumps({key: to_data(attrgetter(ALIASES.get(key) or key)(scenario)) for key in overrides}))
    assert scenario.difference(make_scenario("ieee33-weak", **again)) is None


@pytest.mark.parametrize("name", [name for name in PLAIN if name != "reward"])  # which pays each agent alone
def test_a_field_goes_through_the_spec_of_an_environment(name):
    overrides = {name: PLAIN[name], **WITH.get(name, {})}
    env: Any = gymnasium.make("dcgrid/IEEE33Weak-v0", **overrides)
    again: Any = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.scenario.difference(env.unwrapped.scenario) is None
    env.close()
    again.close()


def test_objects_go_through_the_spec_of_an_environment_too():
    fault = Fault(("dc_0",), (1.0, 2.0))
    objects = {
        "weights": CostWeights(backlog=1),
        "faults": (fault,),
        "datacenters.clock_law": PrefillDecodeDvfs(),
        "feeder": load_feeder("ieee33"),
    }
    env: Any = gymnasium.make(
        "dcgrid/IEEE33Weak-v0", horizon=30, **{"datacenters.p_rated_kw": np.float64(900.0)}, **objects
    )
    again: Any = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.scenario.difference(env.unwrapped.scenario) is None
    assert again.unwrapped.scenario.faults == (fault,)
    assert again.unwrapped.scenario.horizon == 30
    batch: Any = gymnasium.make_vec("dcgrid/IEEE33Weak-v0", num_envs=2, **objects)
    assert batch.spec.kwargs["datacenters.clock_law"]["law"] == "prefill-decode"
    assert batch.spec.kwargs["weights"]["backlog"] == 1
    for made in (env, again, batch):
        made.close()


@pytest.mark.parametrize("overrides", [{}, {"horizon": 7, "faults": (Fault(("dc_0",), (1.0, 2.0)),), "name": "own"}])
def test_a_scenario_goes_through_the_spec_of_an_environment(overrides):
    scenario = make_scenario("mixed", **overrides)
    for given in (scenario, pickle.loads(pickle.dumps(scenario))):
        env: Any = gymnasium.make("dcgrid/IEEE33Weak-v0", scenario=given)
        again: Any = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
        assert again.unwrapped.scenario.difference(scenario) is None
        assert scenario_hash(again.unwrapped.scenario) == scenario_hash(scenario)
        env.close()
        again.close()


def test_what_has_no_plain_form_is_refused_by_name_where_a_spec_is_written():
    trace = PowerTrace([0.0, 500.0, 1000.0], [1.0, 0.5, 0.5], "own")
    env: Any = gymnasium.make("dcgrid/IEEE33Weak-v0", scenario=make_scenario("ieee33", trace=(trace,)))
    with pytest.raises(ScenarioError, match=r"scenario.workload.trace\[0\] is a PowerTrace that is in no file"):
        env.spec.to_json()
    env.close()


def test_weights_that_a_mapping_leaves_out_keep_their_value():
    assert make_scenario("training", weights={"backlog": 1}).cost.weights == CostWeights(backlog=1, leftover=90.0)
    assert make_scenario("ieee33").replace(weights={"loss": 2.0}).cost.weights == CostWeights(loss=2.0)
    with pytest.raises(ScenarioError, match=r"cost.weights.volts is no field; did you mean voltage.* loss"):
        make_scenario("ieee33", weights={"volts": 1})
    with pytest.raises(ScenarioError, match=r"weights.backlog is 'dear'; give a finite number"):
        make_scenario("ieee33", weights={"backlog": "dear"})
    with pytest.raises(ScenarioError, match=r"weights is \(1.0, 2.0\); give CostWeights"):
        make_scenario("ieee33", weights=[1.0, 2.0])


def test_clock_laws_by_name():
    assert (
        make_scenario("ieee33", datacenters={"clock_law": "prefill-decode"}).datacenters.clock_law
        == PrefillDecodeDvfs()
    )
    assert make_scenario("ieee33", datacenters={"clock_law": "linear"}).datacenters.clock_law == LinearDvfs()
    assert make_scenario("ieee33", datacenters={"clock_law": {"law": "linear"}}).datacenters.clock_law == LinearDvfs()
    assert to_data(LinearDvfs()) == "linear"
    with pytest.raises(
        ScenarioError, match=r"datacenters.clock_law is \{'law': 'fast'\}; give 'linear', 'prefill-decode'"
    ):
        make_scenario("ieee33", datacenters={"clock_law": {"law": "fast"}})
    with pytest.raises(ScenarioError, match="'prefill-decode' has no parameter 'share'; there are decode_clock_share"):
        make_scenario("ieee33", datacenters={"clock_law": {"law": "prefill-decode", "share": 1}})
    with pytest.raises(ScenarioError, match="decode_clock_share is 2; give a share"):
        make_scenario("ieee33", datacenters={"clock_law": {"law": "prefill-decode", "decode_clock_share": 2}})


def test_faults_as_mappings():
    one = make_scenario("ieee33", faults={"among": ["dc_1"], "begin_s": [1, 2]})
    assert one.faults == (Fault(("dc_1",), (1, 2)),)
    for fault, message in (
        ({"among": ["dc_1"]}, r"faults\[0\].begin_s is missing; give it"),
        (
            {"among": ["dc_1"], "begin": [1, 2]},
            r"faults\[0\].begin is no field; did you mean begin_s\? its fields are among, beg",
        ),
        ({"among": ["dc_1"], "begin_s": -3}, r"faults\[0\].begin_s is -3; give a number from 0 to"),
        ({"among": ["dc_1"], "begin_s": [2, 1]}, r"faults\[0\].begin_s is \[2, 1\]; give the lowest first"),
        ({"among": "dc_1", "begin_s": [1, 2]}, r"faults\[0\].among is 'dc_1'; give a tuple of"),
    ):
        with pytest.raises(ScenarioError, match=message):
            make_scenario("ieee33", faults=[fault])


def test_recordings_and_feeders_by_path(tmp_path):
    trace = generate_inference(700.0, 3)
    path = tmp_path / "site.csv"
    rows = zip(trace.time_s.tolist(), (1e3 * trace.power_kw).tolist(), strict=True)
    path.write_text("time_s,site_w\n" + "".join(f"{t},{w}\n" for t, w in rows))
    wanted = PowerTrace.from_csv(path)
    for given in (str(path), path, [str(path)], (str(path),)):
        scenario = make_scenario("ieee33-weak", trace=given)
        assert isinstance(scenario.workload.trace, tuple)
        np.testing.assert_array_equal(scenario.workload.trace[0].power_kw, wanted.power_kw)
    sun = make_scenario("ieee33-weak", inverters={"injection": str(path)}).inverters.injection
    assert isinstance(sun, PowerTrace)
    with pytest.raises(ScenarioError, match=r"trace is '.*none.csv'"):
        make_scenario("ieee33-weak", trace=[str(tmp_path / "none.csv")])
    with pytest.raises(ScenarioError, match=r"trace is 'none\.csv'; `dcgrid list traces`"):
        make_scenario("ieee33-weak", trace="none.csv")
    cases = Path(__file__).parents[2] / "cases" / "ieee33"
    if (cases / "feeder.toml").exists():
        assert isinstance(make_scenario("ieee33-weak", feeder=str(cases)).feeder, Feeder)


def test_a_file_that_has_changed_is_read_again(tmp_path):
    path = tmp_path / "site.csv"
    scenarios = []
    for watts in (100, 200, 300):
        path.write_text("time_s,site_w\n" + "".join(f"{t},{watts + t % 2}\n" for t in range(900)))
        given = str(path) if watts == 100 else (str(path),)
        scenarios.append(make_scenario("ieee33-weak", trace=given))
    assert [s.workload.trace[0].power_kw[0] for s in scenarios] == [0.1, 0.2, 0.3]


@pytest.mark.parametrize(
    ("good", "bad"),
    [
        ({"horizon": 5}, {"horizon": 5.0}),
        ({"horizon": 1}, {"horizon": True}),
        ({"sensing.preview": True}, {"sensing.preview": 1}),
        ({"sensing.delay_steps": 1}, {"sensing.delay_steps": True}),
        ({"source_voltage_pu": 1}, {"source_voltage_pu": True}),
        ({"datacenters.p_rated_kw": (1, 1.0, 1)}, {"datacenters.p_rated_kw": (True, 1.0, 1)}),
        ({"weights": {"backlog": 1}}, {"weights": {"backlog": True}}),
    ],
)
def test_what_is_refused_does_not_depend_on_what_was_made_before(good, bad):
    made = make_scenario("ieee33-weak", **good)
    with pytest.raises(ScenarioError):
        make_scenario("ieee33-weak", **bad)
    assert make_scenario("ieee33-weak", **good) is made


def test_an_hour_that_there_is_not():
    for hour in (24, -1, "noon", True, float("nan")):
        with pytest.raises(
            ScenarioError, match=r"background.start_hour is .*; give an hour from 0 to less than 24, 'random', or"
        ):
            make_scenario("ieee33", background={"start_hour": hour})


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ({"name": None}, "name is None; give a text that is not empty"),
        ({"name": ""}, "name is ''; give a text"),
        ({"horizon": 10**12}, "horizon is 1000000000000; give a whole number of at least 1 and at most 100,000,000"),
        ({"sensing.delay_steps": 10**20}, "sensing.delay_steps is .*; give a whole number of at least 0 and at most"),
        ({"datacenters.p_rated_kw": 10**400}, "datacenters.p_rated_kw is 1000.*; give one positive number of at most"),
        ({"datacenters.f_max_mhz": 10**400}, "datacenters.f_max_mhz is 1000.*; give a finite number"),
        ({"inverters.buses": [[1]]}, r"inverters.buses has \(1,\), no number or text"),
        ({"inverters.buses": [7.0, 14]}, r"inverters.buses has 7\.0, no number or text"),
        ({"datacenters.clock_law": {"law": ["x"]}}, "datacenters.clock_law is .*; give 'linear'"),
        ({"datacenters.clock_law": PrefillDecodeDvfs}, "datacenters.clock_law is .*; give 'linear'"),
        ({"trace": "x" * 5000}, "trace is .*; `dcgrid list traces` lists all"),
        ({"feeder": "x" * 5000}, "no feeder"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_nonsense_is_one_clear_error(override, message):
    with pytest.raises((ScenarioError, FeederError), match=message):
        make_scenario("ieee33-weak", **override)


def test_arrays_without_dimension_and_durations_of_null_are_taken():
    assert make_scenario("ieee33-weak", horizon=np.array(3)).horizon == 3
    fault = Fault(("dc_0",), (0, 1))
    given = {"among": ["dc_0"], "begin_s": np.array([0, 1]), "duration_s": None}
    assert make_scenario("ieee33-weak", faults=[given]).faults == (fault,)
    assert to_data(fault) == {"among": ["dc_0"], "begin_s": [0, 1]}
