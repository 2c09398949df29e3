"""The parts of a scenario: given as objects, mappings or paths, they are one thing, and each checks itself."""

import dataclasses
import pickle
from operator import attrgetter
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

from dcgrid_env import (
    Background,
    Cost,
    CostWeights,
    DataCenters,
    Inverters,
    Scenario,
    ScenarioError,
    Sensing,
    Workload,
    make_scenario,
)
from dcgrid_env.core.checked import FieldError
from dcgrid_env.scenario.assembly import ALIASES, FORMER

SITES = DataCenters(count=1, buses=("18",), p_rated_kw=500.0, s_rated_share=1.1, q_max_share=0.3)
WAYS: dict[str, tuple[dict[str, Any], dict[str, Any], dict[str, Any]]] = {
    "sensing": (
        {"sensing": Sensing(noise_pu=0.005, delay_steps=1)},
        {"sensing": {"noise_pu": 0.005, "delay_steps": 1}},
        {"sensing.noise_pu": 0.005, "sensing.delay_steps": 1},
    ),
    "workload": (
        {"workload": Workload(trace="code", window="together")},
        {"workload": {"trace": "code", "window": "together"}},
        {"trace": "code", "workload.window": "together"},
    ),
    "background": (
        {"background": Background(load_sigma=0.1, start_hour=6.5)},
        {"background": {"load_sigma": 0.1, "start_hour": 6.5}},
        {"background.load_sigma": 0.1, "background.start_hour": 6.5},
    ),
    "cost": (
        {"cost": Cost(weights=CostWeights(backlog=1.0), voltage="l2")},
        {"cost": {"weights": {"backlog": 1.0}, "voltage": "l2"}},
        {"weights": {"backlog": 1.0}, "cost.voltage": "l2"},
    ),
    "voltage": ({"source_voltage_pu": 1.01}, {"source_voltage_pu": np.float64(1.01)}, {"source_voltage_pu": 1.01}),
}


@pytest.mark.parametrize("part", WAYS)
def test_objects_mappings_and_paths_are_one_thing(part):
    one, two, three = (make_scenario("ieee33-weak", **given) for given in WAYS[part])
    assert one.difference(two) is None
    assert one.difference(three) is None
    assert one.difference(make_scenario("ieee33-weak")) is not None
    assert pickle.loads(pickle.dumps(one)).difference(one) is None


@pytest.mark.parametrize("part", WAYS)
@pytest.mark.parametrize("way", [0, 1, 2])
def test_each_way_goes_through_the_spec_of_an_environment(part, way):
    env: Any = gymnasium.make("dcgrid/IEEE33Weak-v0", **WAYS[part][way])
    again: Any = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.scenario.difference(env.unwrapped.scenario) is None
    env.close()
    again.close()


def test_devices_go_through_the_spec_of_an_environment():
    devices = make_scenario("ieee33").devices
    env: Any = gymnasium.make("dcgrid/IEEE33Weak-v0", devices=devices)
    again: Any = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.scenario.devices == env.unwrapped.scenario.devices == devices


def test_a_mapping_changes_what_it_names_and_leaves_the_rest():
    robust = make_scenario("robust")
    changed = robust.replace(sensing={"noise_pu": 0.001})
    assert changed.sensing == dataclasses.replace(robust.sensing, noise_pu=0.001)
    training = make_scenario("training")
    assert training.replace(cost={"weights": {"loss": 1.0}}).cost.weights == training.cost.weights._replace(loss=1.0)


def test_short_names_are_taken_and_former_names_refused_with_their_path():
    scenario = make_scenario("fault")
    for name, path in ALIASES.items():
        assert scenario.replace(**{name: attrgetter(path)(scenario)}).difference(scenario) is None
    for name, path in FORMER.items():
        attrgetter(path)(scenario)
        with pytest.raises(TypeError, match=f"^no scenario field '{name}': it is {path} now$"):
            scenario.replace(**{name: None})


def test_a_path_that_is_none_gets_the_nearest():
    with pytest.raises(TypeError, match=r"^no scenario field 'sensin.noise_pu'; did you mean sensing.noise_pu"):
        make_scenario("ieee33", **{"sensin.noise_pu": 0.1})
    with pytest.raises(ScenarioError, match=r"sensing.noise is no field; did you mean noise_pu"):
        make_scenario("ieee33", **{"sensing.noise": 0.1})


def test_a_scenario_of_parts_alone():
    flat = make_scenario("ieee33-weak")
    sites = DataCenters(count=3, buses=("18", "33", "25"), p_rated_kw=1000.0, s_rated_share=1.02, q_max_share=0.33)
    inverters = Inverters(buses=("7", "14", "20", "30"), s_rated_kva=100.0)
    own = Scenario(name="ieee33-weak", feeder="ieee33", source_voltage_pu=1.05, devices=(sites, inverters))
    assert own.difference(flat) is None
    alone = Scenario(name="alone", feeder="ieee33", source_voltage_pu=1.05, devices=(inverters,))
    assert alone.agents == ("inv_0", "inv_1", "inv_2", "inv_3")
    assert alone.datacenters.count == 0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sensing(noise_pu=-1.0), r"^Sensing: noise_pu is -1.0; give a finite number in \[0, 1\]$"),
        (lambda: Background(start_hour=24.0), r"^Background: start_hour is 24.0; give an hour from 0 to less than 24"),
        (lambda: Workload(trace="x"), r"^Workload: trace is 'x'; `dcgrid list traces` lists all"),
        (lambda: Cost(reward="mine"), r"^Cost: reward is 'mine'; choose one of shared, local, difference$"),  # type: ignore
        (lambda: Inverters(buses=("3",)), r"^Inverters: s_rated_kva is 0.0; give one positive number"),
        (lambda: DataCenters(count=-1, p_rated_kw=1.0, s_rated_share=1.0, q_max_share=0.0), "count is -1; give"),
    ],
)  # fmt: skip
def test_a_part_checks_itself(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"sensing": {"noise": 0.1}}, r"^scenario 'ieee33': sensing.noise is no field; did you mean noise_pu"),
        ({"sensing": {"noise_pu": "0.1"}}, r"sensing.noise_pu is '0.1'; give a finite number in"),
        ({"sensing": {"noise_pu": 2.0}}, r"sensing.noise_pu is 2.0; give a finite number in \[0, 1\]"),
        ({"sensing.noise_pu": 2.0}, r"sensing.noise_pu is 2.0; give a finite number in \[0, 1\]"),
        ({"sensing": {"preview": 1}}, "sensing.preview is 1; choose one of True, False"),
        ({"sensing": Background()}, r"sensing is Background\(.*; give Sensing\(...\) or a mapping of its fields"),
        ({"sensing": {"noise_pu": 0.1}, "sensing.noise_pu": 0.1}, "sensing.noise_pu is given twice; give it once"),
        ({"observe": "local", "sensing.observe": "local"}, "sensing.observe is given twice; give it once"),
        ({"devices": ["datacenter"]}, r"devices\[0\] is 'datacenter'; give a device \(DataCenters, Inverters"),
        ({"devices": {"kind": "inverter", "buses": ["3"], "s_rated_kva": 1.0, "x": 1}}, r"devices\[0\].x is no field"),
        ({"sensing": Sensing(), "sensing.noise_pu": 0.1}, "sensing.noise_pu is given, and sensing as a whole too"),
        ({"devices": [SITES], "datacenters": SITES}, "datacenters is given, and devices has such a group; give one"),
        ({"cost.weights.clock": 1.0}, "cost.weights.clock is too deep a path; give cost.weights a mapping"),
        ({"sensing": None}, "sensing is None; leave it out"),
        ({"devices": None}, "devices is None; leave it out"),
        ({"devices": [Inverters]}, r"devices\[0\] is <class .*; give a device"),
        ({"devices": [Inverters(buses=(bus,), s_rated_kva=1.0) for bus in "34"]}, "more than one group"),
    ],
    ids=lambda value: str(value)[:40],
)  # fmt: skip
def test_what_cannot_be_is_named_as_it_was_given(given, message):
    with pytest.raises(ScenarioError, match=message):
        make_scenario("ieee33", **given)


def test_a_group_of_devices_goes_through_the_spec_of_an_environment():
    env: Any = gymnasium.make("dcgrid/IEEE33-v0", datacenters=SITES)
    again: Any = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.scenario.datacenters == env.unwrapped.scenario.datacenters == SITES


def test_a_weight_of_numpy_becomes_pythons_own():
    weights = make_scenario("ieee33", weights={"backlog": np.float32(0.5)}).cost.weights
    assert type(weights.backlog) is float


def test_an_error_of_a_field_can_be_pickled():
    for make in (lambda: Sensing(noise_pu=2.0), lambda: Cost(weights={"volts": 1})):
        with pytest.raises(FieldError) as caught:
            make()
        assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


def test_inverters_alone_make_a_scenario():
    alone = Scenario(
        name="alone", feeder="ieee33", source_voltage_pu=1.0, inverters={"buses": ("7",), "s_rated_kva": 100.0}
    )
    assert alone.agents == ("inv_0",)
