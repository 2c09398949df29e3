"""Guarded policies: the law outside the trained range, bounds in new places, and their report."""

import warnings

import numpy as np
import pytest

from dcgrid_env import make_scenario, parallel_env
from dcgrid_env.agents import Card, Network, Policy, PolicyError, UnseenScenarioWarning, evaluate, guarded
from dcgrid_env.agents.policy import guard as guard_module
from dcgrid_env.agents.policy.guard import DEVIATION, FIGURES, GuardedPolicy, law_for, steepest
from dcgrid_env.agents.policy.input_range import InputRange, recorded
from dcgrid_env.baselines import Droop, NoControl, find_controller, make_controller, rollout
from dcgrid_env.baselines.laws.stability import is_stable, worst_radius
from dcgrid_env.baselines.rollout import ControllerError


@pytest.fixture
def toy6():
    return make_scenario("toy6", split="validation", horizon=30)


def constant(q_share, **more):
    """A policy that gives one share of reactive power everywhere."""
    networks = {
        "datacenter": Network([(np.zeros((9, 2)), [1.0, q_share])]),
        "inverter": Network([(np.zeros((7, 1)), [q_share])]),
    }
    return Policy(networks, scenario="toy6", **more)


def courses(scenario, controller, n=2):
    run = rollout(scenario, controller, range(n))
    return np.stack([run.series(i).v_pu for i in range(n)])


def test_at_home_and_within_the_range_it_is_the_policy_itself(toy6):
    policy = constant(0.3)
    ranges = range_of(policy, toy6, 4)
    own = GuardedPolicy(policy, {name: widened(r, 1.0) for name, r in ranges.items()})
    np.testing.assert_array_equal(courses(toy6, own), courses(toy6, policy))
    assert own.episode_figures() == [dict.fromkeys(FIGURES, 0.0)] * 2


def range_of(policy, scenario, episodes):
    ranges = recorded(policy, [scenario], episodes)
    assert ranges is not None
    return ranges


def widened(own, by):
    return own._replace(low=tuple(low - by for low in own.low), high=tuple(high + by for high in own.high))


def test_beyond_the_range_it_is_the_law(toy6):
    policy, law = constant(0.3), make_controller("droop-tuned", toy6)
    moved = {  # of the voltage alone: places are known
        name: own._replace(low=(5.0, *own.low[1:]), high=(6.0, *own.high[1:]))
        for name, own in range_of(policy, toy6, 4).items()
    }
    under = GuardedPolicy(policy, moved)
    np.testing.assert_allclose(courses(toy6, under), courses(toy6, law), atol=1e-6)
    (figures, _) = under.episode_figures()
    assert figures["guard_law_pct"] == 100.0
    assert figures["guard_new_places_pct"] == 0.0


def test_in_new_places_the_deviation_is_bounded(toy6, monkeypatch):
    monkeypatch.setattr(guard_module, "steepest", lambda scenario: (np.inf, np.inf))
    policy = constant(1.0)
    ranges = {name: widened(own, 1e3) for name, own in range_of(policy, toy6, 2).items()}
    at, own = ranges["inverter"].fields.index("r"), ranges["inverter"]
    low, high = ([*end[:at], place, *end[at + 1 :]] for end, place in ((own.low, 5.0), (own.high, 6.0)))
    ranges["inverter"] = own._replace(low=tuple(low), high=tuple(high))
    own = GuardedPolicy(policy, ranges, NoControl())
    run = rollout(toy6, own, [0])
    share = run.series(0).q_kvar[1:] / toy6.q_scale_kvar
    assert share[:, 0].max() == pytest.approx(DEVIATION["q"], abs=1e-6)  # the data centre's, within range
    np.testing.assert_array_equal(share[:, 1:], 0.0)  # the inverters', whose place is unknown
    assert own.episode_figures()[0]["guard_new_places_pct"] == 100.0
    assert own.episode_figures()[0]["guard_bound_pct"] > 0.0
    assert own.info.keys() == set(FIGURES)
    assert np.isfinite([float(np.mean(value)) for value in own.info.values()]).all()


def test_in_new_places_the_gain_stays_below_the_bound(monkeypatch):
    scenario = make_scenario("ieee33", split="validation", horizon=4)
    own = guarded("ieee33-weak-analytic")
    assert isinstance(own, GuardedPolicy)
    rollout(scenario, own, [0])
    assert own.episode_figures()[0]["guard_new_places_pct"] == 100.0
    joint = np.zeros((1, len(own._v_step)), np.float32)
    at = np.flatnonzero(own._v_step)
    monkeypatch.setattr(own.policy, "probe", lambda seen: -50.0 * seen[:, at][:, own._owner])  # far too steep
    share = own._stable_share(joint, own._law)
    reactive, _ = steepest(own.scenario)
    law = (own._law.act(joint - own._v_step) - own._law.act(joint + own._v_step)) / (2 * guard_module.STEP)
    slope = (1.0 - share) * law + share * 50.0
    assert (slope[..., own._is_q] <= np.maximum(reactive, law[..., own._is_q]) + 1e-3).all()
    assert (share[..., own._is_q] < 0.5).all()


def test_it_comes_back_from_the_law_step_by_step(toy6):
    policy = constant(0.3)
    ranges = {name: widened(own, 1e3) for name, own in range_of(policy, toy6, 2).items()}
    own = GuardedPolicy(policy, ranges)
    own.reset(toy6)
    inside = np.zeros((1, len(own._v_step)), np.float32)
    outside = inside + 1e6 * (own._v_step > 0)
    shares = []
    for observation in (inside, outside, inside, inside):
        own.act(observation.astype(np.float32))
        shares.append(float(np.mean(own._share)))
    step = 1.0 / guard_module.RETURN_STEPS
    assert shares == pytest.approx([1.0, 0.0, step, 2 * step])


def test_the_two_forms_of_observation_give_the_same_actions():
    own, other = guarded("toy6-analytic"), guarded("toy6-analytic")
    env = parallel_env(make_scenario("toy6", split="validation"))
    seen, _ = env.reset(seed=0)
    own.reset(env.scenario)
    other.reset(env.scenario)
    joint = other.act(np.concatenate([seen[agent] for agent in env.agents]))
    np.testing.assert_array_equal(np.concatenate(list(own.act(seen).values())), joint)
    env.close()


def test_by_its_name_on_the_command_line(toy6, tmp_path):
    found = find_controller("guarded:toy6-analytic", toy6)
    assert isinstance(found, GuardedPolicy)
    assert (
        found.ranges
        == Card.load(guard_module.Path(guard_module.__file__).parents[1] / "policies/toy6-analytic.json").inputs
    )
    assert isinstance(find_controller("guarded:analytic", toy6), GuardedPolicy)
    constant(0.3).save(tmp_path / "own")
    filed = find_controller(f"guarded:{tmp_path / 'own'}.safetensors", toy6)
    assert isinstance(filed, GuardedPolicy)
    assert filed.ranges is None
    with pytest.raises(ValueError, match="guarded: it guards learned policies, and this is Droop"):
        find_controller("guarded:droop", toy6)
    means = evaluate(found, toy6, range(2)).means
    assert set(FIGURES) <= set(means)


def test_on_a_scenario_that_it_was_not_made_for_it_is_no_worse_than_half_below_the_droop():
    """ieee33-weak-analytic by itself has -219 on mixed."""
    scenario = make_scenario("mixed", split="validation")
    droop = evaluate(make_controller("droop-tuned", scenario), scenario, range(4)).means["J"]
    under = evaluate(guarded("ieee33-weak-analytic"), scenario, range(4)).means["J"]
    with pytest.warns(UnseenScenarioWarning):
        plain = evaluate(Policy.load("ieee33-weak-analytic"), scenario, range(4)).means["J"]
    assert under < 1.05 * droop
    assert plain > 5.0 * droop


def test_without_a_card_the_range_is_recorded_on_the_training_scenario(toy6):
    policy = constant(0.3)
    assert policy.card is None
    own = guarded(policy)
    assert isinstance(own, GuardedPolicy)
    courses(toy6, own)
    assert own.ranges == range_of(policy, make_scenario("toy6"), 64)
    policy.trained_on = ""
    with pytest.raises(ControllerError, match="not on a card, and not known: the policy names no scenario") as raised:
        courses(toy6, guarded(policy))
    assert isinstance(raised.value.__cause__, PolicyError)


def test_without_tuned_gains_the_law_is_the_droop_within_the_stability_bound():
    scenario = make_scenario("ieee33-weak", datacenters={"p_rated_kw": 900.0}, inverters={"s_rated_kva": 2000.0})
    law = law_for(scenario)
    assert isinstance(law, Droop)
    assert is_stable(worst_radius(scenario, law))
    with pytest.raises(ValueError, match="which is no file"):
        law_for(scenario, "nowhere.json")


def test_how_far_beyond_a_range_an_input_lies():
    own = InputRange(("v_deviation", "r", "p"), (-1.0, 0.2, 0.0), (1.0, 0.2, 4.0))
    np.testing.assert_allclose(own.beyond(np.array([[1.5, 0.2, 2.0], [-3.0, 0.201, 6.0]])),
                               [[0.25, 0.0, 0.0], [1.0, 0.1, 0.5]], atol=1e-9)  # fmt: skip
    assert own.of_place.tolist() == [False, True, False]


def test_a_range_of_other_inputs_is_refused(toy6):
    policy = constant(0.3)
    ranges = range_of(policy, toy6, 2)
    ranges["inverter"] = ranges["inverter"]._replace(fields=("a",) * 10)
    with pytest.raises(ControllerError, match="range of inputs of network inverter is of a, a"):
        courses(toy6, GuardedPolicy(policy, ranges))


class Counting(Network):
    """A network that counts the steps that it remembers."""

    def advance(self, observation, memory):
        count = 0 if memory is None else memory[0]
        return np.full((*observation.shape[:-1], self.n_out), 0.1 * count, np.float32), (count + 1,)


def test_what_a_policy_remembers_is_left_alone_where_slopes_are_found(toy6):
    site, inverter = Counting([(np.zeros((9, 2)), np.zeros(2))]), Counting([(np.zeros((7, 1)), np.zeros(1))])
    policy = Policy({"datacenter": site, "inverter": inverter})
    policy.reset(toy6)
    joint = np.zeros((1, 23), np.float32)
    assert [float(policy.probe(joint)[0, 1]) for _ in range(2)] == [0.0, 0.0]
    policy.act(joint)
    assert float(policy.probe(joint)[0, 1]) == float(policy.act(joint)[0, 1]) == pytest.approx(0.1)


def test_under_guard_a_policy_remembers_each_step_once(toy6):
    site, inverter = Counting([(np.zeros((9, 2)), np.zeros(2))]), Counting([(np.zeros((7, 1)), np.zeros(1))])
    policy = Policy({"datacenter": site, "inverter": inverter}, scenario="toy6")
    own = GuardedPolicy(policy, {name: widened(r, 1e3) for name, r in range_of(policy, toy6, 1).items()})
    own.reset(toy6)
    joint = np.zeros((1, 23), np.float32)
    assert [float(own.act(joint)[0, 1]) for _ in range(3)] == pytest.approx([0.0, 0.1, 0.2])


def test_a_guarded_policy_does_not_warn():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        courses(make_scenario("ieee33", split="validation", horizon=3), guarded("ieee33-weak-analytic"))
