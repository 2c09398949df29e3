"""The model-aided local law: better than the tuned droop where it is made for, local in use, refusals."""

import numpy as np
import pytest

from dcgrid_env import DcgridVectorEnv, field_names, make_scenario
from dcgrid_env.baselines import make_controller, rollout
from dcgrid_env.baselines.model_aided.model_aided import ModelAided


@pytest.mark.parametrize(("preset", "share"), [("ieee33-weak", 0.97), ("ieee33", 0.97), ("robust", 0.87)])
def test_it_is_better_than_the_tuned_droop_on_validation(preset, share):
    scenario = make_scenario(preset, split="validation")
    droop = rollout(scenario, make_controller("droop-tuned", scenario), range(4)).costs().mean()
    assert rollout(scenario, ModelAided(), range(4)).costs().mean() < share * droop


def test_an_agent_acts_on_its_own_observation_alone():
    scenario = make_scenario("ieee33")
    env = DcgridVectorEnv(2, scenario)
    observations, _ = env.reset(seed=[0, 0])
    width = len(field_names(scenario)["dc_0"])
    others = observations.copy()
    others[1, width:] += 0.1
    law = ModelAided()
    law.reset(scenario)
    action = law.act(others)
    assert (action[0, :2] == action[1, :2]).all()
    assert not (action[0, 2:] == action[1, 2:]).all()
    env.close()


def test_drawn_buses_must_be_placed():
    law = ModelAided()
    scenario = make_scenario("ieee123")
    law.reset(scenario)
    env = DcgridVectorEnv(1, scenario)
    observations, _ = env.reset(seed=0)
    with pytest.raises(ValueError, match=r"call place\(buses\) after reset"):
        law.act(observations)
    env.close()


def test_where_buses_are_drawn_each_placement_is_commissioned():
    law, scenario = ModelAided(), make_scenario("ieee123")
    law.reset(scenario)
    inverters = [scenario.feeder.index(bus) for bus in scenario.devices[1].buses or ()]
    first, second = (np.array([[*range(at, at + scenario.datacenters.count), *inverters]]) for at in (10, 60))
    law.place(first)
    before = law.known
    law.place(second)
    assert before is not None
    assert law.known is not None
    assert not np.array_equal(before.by_q, law.known.by_q)


@pytest.mark.parametrize("given", [{"floor_pu": 0.0}, {"price": -1.0}, {"hold": float("nan")}])
def test_what_cannot_be_is_refused(given):
    (name,) = given
    with pytest.raises(ValueError, match=f"model-aided: {name} is"):
        ModelAided(**given)


@pytest.mark.parametrize("preset", ["smoothing", "ieee33-weak-ups"])
def test_devices_that_it_does_not_know_are_refused(preset):
    with pytest.raises(ValueError, match="model-aided"):
        ModelAided().reset(make_scenario(preset))


def test_the_clock_is_left_alone_where_the_band_is_always_left():
    scenario = make_scenario("ieee33", source_voltage_pu=0.9, split="validation", horizon=20)
    assert rollout(scenario, ModelAided(), range(2)).metrics()[0]["delay_mean_s"] == 0.0


def test_the_first_second_is_no_surprise():
    """All begin without reactive power, and go on as if they stood at u*: they are near it after a second."""
    scenario = make_scenario("ieee33", split="validation")
    env = DcgridVectorEnv(8, scenario)
    observations, _ = env.reset(seed=list(range(8)))
    law = ModelAided()
    law.reset(scenario)
    env.step(law.act(observations))
    env.close()
    assert law.known is not None
    q_kvar, rest_kvar = env.transition.state.q_kvar, law.known.rest_kvar[0, 0]
    assert abs(q_kvar - rest_kvar).mean() < 0.25 * abs(rest_kvar).mean()
