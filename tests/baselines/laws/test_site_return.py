"""Return by hand and staggered return: who is back when, in every interface."""

import numpy as np
import pytest

from dcgrid_env import make_scenario, parallel_env
from dcgrid_env.baselines import Droop, ReturnByHand, StaggeredReturn, make_controller, rollout
from dcgrid_env.baselines.model_based.hindsight import hindsight
from dcgrid_env.baselines.rollout import ControllerError
from helpers.riding import ride_through_34


def first_back_s(law):
    """When each site first has power again after the lock-out at the third sag, s from the first that has."""
    ups = rollout(ride_through_34(), law, [2]).series(0).devices[0].ups
    locked = np.flatnonzero(ups.locked.all(axis=1))[0]
    back = locked + (ups.share[locked:] > 0.0).argmax(axis=0)
    return (back - back.min()).tolist()


@pytest.mark.slow
def test_by_hand_all_return_at_once_and_staggered_one_after_the_other():
    slots = ride_through_34().datacenters.count
    assert first_back_s(ReturnByHand()) == [0] * slots
    assert first_back_s(StaggeredReturn()) == [20 * i for i in range(slots)]


@pytest.mark.slow
def test_without_a_rule_they_return_at_once_and_trip_again():
    scenario = ride_through_34()
    hasty, by_hand = (rollout(scenario, law, [2]).metrics()[0] for law in (Droop(), ReturnByHand()))
    assert hasty["ups_trips"] > by_hand["ups_trips"]
    assert hasty["ups_away_s"] < by_hand["ups_away_s"]


def test_agents_apart_are_driven_as_one():
    scenario = ride_through_34(horizon=100)
    env, law = parallel_env(scenario), StaggeredReturn()
    observations, _ = env.reset(seed=2)
    law.reset(scenario)
    apart = []
    while env.agents:
        observations, rewards, _, _, _ = env.step(law.act(observations))
        apart.append(rewards["dc_0"])
    together = rollout(scenario, StaggeredReturn(), [2]).series(0).cost_j
    assert -np.array(apart) == pytest.approx(together, rel=1e-9)


def test_a_scenario_without_the_channel_is_refused():
    with pytest.raises(ValueError, match="return rules: the sites of scenario 'ieee33-weak' have no channel 'return'"):
        ReturnByHand().reset(make_scenario("ieee33-weak"))


def test_times_and_pace_may_be_set_apart_from_the_rule():
    """Site 1 returns 25 s after the only event, and site 2 four seconds later, both at half the pace."""
    scenario = ride_through_34(sags=({"begin_s": 5.5, "duration_s": 0.05, "retained_pu": 0.3},))
    law = StaggeredReturn(return_delay_s=25.0, stagger_s=4.0, pace=0.5)
    share = rollout(scenario, law, [2]).series(0).devices[0].ups.share
    gone, back = (share == 0.0).argmax(axis=0), ((share > 0.0) & (np.arange(len(share)) > 20)[:, None]).argmax(axis=0)
    assert gone.tolist() == [6, 6]
    assert (back[1] - back[0], share[back, [0, 1]].tolist()) == (4, pytest.approx([0.05, 0.05]))
    assert back[0] == 32  # 25.5 s after the event are seen at the end of step 31


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"pace": 0.0}, r"return rules: pace is 0.0; give more than 0, at most 1"),
        ({"pace": 1.5}, r"return rules: pace is 1.5; give more than 0, at most 1"),
        ({"release_s": -1.0}, r"return rules: release_s is -1.0; give a finite number >= 0"),
        ({"stagger_s": float("nan")}, r"return rules: stagger_s is nan; give a finite"),
    ],
)
def test_bad_parameters(given, message):
    with pytest.raises(ValueError, match=message):
        StaggeredReturn(**given)


def test_a_wait_that_no_agent_can_see_is_refused():
    with pytest.raises(ValueError, match=r"the last site would return after 120 s, but ups_wait .* counts to 80 s"):
        StaggeredReturn(stagger_s=60.0).reset(ride_through_34())


def test_tuned_without_the_channel_is_refused_as_the_law_is():
    scenario = make_scenario("toy6", horizon=3)
    with pytest.raises(ControllerError, match="have no channel 'return'"):
        rollout(scenario, make_controller("staggered-return-tuned", scenario), [0])


def test_hindsight_refuses_what_no_linear_program_has():
    with pytest.raises(ValueError, match=r"hindsight plans no trips, .* scenario 'ride-through' has ride_through"):
        hindsight(ride_through_34(horizon=5), 0)
