"""Corrections of the law act where a trial on the model says that they pay, and are the law where they do not."""

import numpy as np
import pytest

from dcgrid_env import make_scenario, parallel_env
from dcgrid_env.agents import ModelAidedPolicy, Network, Policy, PolicyError, evaluate, find_controller, guarded
from dcgrid_env.agents.policy import trial_guard
from dcgrid_env.agents.policy.law_interface import FEATURES, OUTPUTS
from dcgrid_env.agents.policy.trial_guard import TriedPolicy, pays
from dcgrid_env.baselines import Droop, ModelAided, rollout


def giving(*values):
    """Networks that always give these values, of served power, of the way to u* and of the shift."""
    networks = {
        kind: Network([(np.zeros((len(FEATURES[kind]), n)), np.array(values[-n:], float))], squash="none")
        for kind, n in OUTPUTS.items()
    }
    return ModelAidedPolicy(networks, scenario="test")


HARMFUL = (0.0, 0.0, 1e3)


def test_what_does_worse_in_the_trial_is_left_out():
    scenario = make_scenario("das69", split="validation", horizon=10)
    law = rollout(scenario, ModelAided(), range(2)).costs()
    assert (rollout(scenario, giving(*HARMFUL), range(2)).costs() > 1.02 * law).all()
    own = guarded(giving(*HARMFUL))
    np.testing.assert_array_equal(rollout(scenario, own, range(2)).costs(), law)
    assert own.info["guard_law_pct"].tolist() == [100.0, 100.0]


def test_on_random_feeders_it_is_tried_on_each():
    scenario = make_scenario("zero-shot", split="validation", horizon=2)
    law = rollout(scenario, ModelAided(), range(2)).costs()
    found = evaluate(guarded(giving(*HARMFUL)), scenario, range(2))
    assert found.means["J"] == pytest.approx(law.mean(), rel=1e-12)


def test_what_pays_in_the_trial_acts_as_it_would_alone(monkeypatch):
    monkeypatch.setattr(trial_guard, "pays", lambda policy, scenario, places: places[:, 0] >= 0)
    scenario = make_scenario("das69", split="validation", horizon=10)
    own, alone = guarded(giving(*HARMFUL)), rollout(scenario, giving(*HARMFUL), range(2)).costs()
    np.testing.assert_array_equal(rollout(scenario, own, range(2)).costs(), alone)
    assert own.info["guard_law_pct"].tolist() == [0.0, 0.0]


@pytest.mark.slow
def test_each_placement_has_its_own_verdict(monkeypatch):
    verdicts = []

    def every_other(policy, scenario, places):
        verdicts.append(np.arange(len(places)) % 2 == 0)
        return verdicts[-1]

    monkeypatch.setattr(trial_guard, "pays", every_other)
    scenario = make_scenario("fault", split="validation", horizon=4)
    own = guarded(giving(*HARMFUL))
    costs = rollout(scenario, own, range(4)).costs()
    of_law, alone = (rollout(scenario, other, range(4)).costs() for other in (ModelAided(), giving(*HARMFUL)))
    by_law = own.info["guard_law_pct"] == 100.0
    assert by_law.sum() == (~verdicts[-1]).sum() == 2
    np.testing.assert_allclose(costs, np.where(by_law, of_law, alone), rtol=1e-12)


def test_a_trial_weighs_policy_and_law_in_the_same_episodes_of_the_training_split(monkeypatch):
    scenario = make_scenario("das69", split="validation", horizon=10)
    assert not pays(giving(0.0, 0.0, 0.0), scenario, place_of(scenario)).any()  # the law itself costs no less
    split = []
    own = trial_guard.transitions

    def watched(trial, driver, seeds, name, options):
        split.append((trial.split, seeds, options["buses"].shape[0], driver.corrects.sum()))
        return own(trial, driver, seeds, name, options)

    monkeypatch.setattr(trial_guard, "transitions", watched)
    pays(giving(*HARMFUL), scenario, place_of(scenario))
    assert split == [("train", [0, 1, 2, 3] * 2, 8, 4)]


def place_of(scenario):
    fixed = [bus for device in scenario.devices for bus in device.buses or ()]
    return np.array([[scenario.feeder.index(bus) for bus in fixed]])


def test_a_model_that_is_said_to_be_wrong_is_no_judge():
    scenario = make_scenario("robust", split="validation", horizon=4)
    own = guarded(giving(*HARMFUL))
    np.testing.assert_array_equal(
        rollout(scenario, own, range(2)).costs(), rollout(scenario, ModelAided(), range(2)).costs()
    )


@pytest.mark.slow
def test_it_drives_the_agents_by_name_and_where_places_are_fixed_needs_no_word_of_them():
    env = parallel_env("das69", horizon=3)
    seen, _ = env.reset(seed=0)
    own, law = guarded(giving(*HARMFUL)), ModelAided()
    for controller in (own, law):
        controller.reset(env.scenario)
    acted, wanted = own.act(seen), law.act(seen)
    for agent in env.agents:
        np.testing.assert_allclose(acted[agent], wanted[agent], atol=1e-6)
    drawn = make_scenario("fault")
    own.reset(drawn)
    assert own.info == {}
    with pytest.raises(PolicyError, match="call place"):
        own.act(parallel_env(drawn).reset(seed=0)[0])


def test_it_takes_no_other_law_and_is_found_by_name():
    with pytest.raises(PolicyError, match="held to that; give no law"):
        guarded(giving(*HARMFUL), Droop())
    scenario = make_scenario("das69")
    found = find_controller("guarded:carry-over", scenario)
    assert isinstance(found, TriedPolicy)
    assert found.policy.sha256 == Policy.load("carry-over").sha256
    assert found.scope == "model-aided"


def test_places_of_another_width_are_refused():
    controller = TriedPolicy(giving(*HARMFUL))
    controller.reset(make_scenario("ieee33-weak", horizon=10))
    for buses in (np.zeros((1, 2), int), np.zeros(7, int)):
        with pytest.raises(PolicyError, match=r"guard: buses has shape .*; give \(row, 7\), a place an agent"):
            controller.place(buses)
