"""A batch of environments: its seeds, partial resets, measurements, a collapse at the reset, and going back."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.core import random
from dcgrid_env.engine.simulation import Simulation
from dcgrid_env.traces import PowerTrace, TraceError


def assert_same(one: Any, other: Any) -> None:
    """Equal arrays all the way down."""
    if isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, other)
    elif isinstance(one, tuple):
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)


def of_env(value: Any, env_index: int) -> Any:
    """One environment of a tuple of arrays."""
    if isinstance(value, np.ndarray):
        return value[env_index]
    if value is None:
        return None
    parts = [of_env(part, env_index) for part in value]
    return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)


@pytest.mark.parametrize(("seed", "like"), [(2**64 + 5, 5), (3 * 2**64 + 5, 5), (-1, 2**64 - 1), (2**64, 0)])
def test_seeds_count_modulo_2_to_the_64(seed, like):
    found, wanted = Simulation(make_scenario("ieee123"), 1), Simulation(make_scenario("ieee123"), 1)
    found.reset([seed])
    wanted.reset([like])
    assert found.now.seeds.tolist() == [like]
    assert_same(found.now[1:], wanted.now[1:])


def test_a_reset_of_some_environments_leaves_the_others_and_begins_anew_in_its_own():
    scenario = make_scenario("ieee33-weak", horizon=8, sensing={"noise_pu": 0.002, "delay_steps": 1})
    rng = np.random.default_rng(0)
    batch = Simulation(scenario, 3)
    batch.reset([0, 1, 2])
    for _ in range(3):
        batch.step(rng.uniform(-1, 1, (3, 10)))
    before = batch.now
    begun = batch.reset([None, 7, None], mask=np.array([False, True, False]))
    fresh = Simulation(scenario, 1)
    first = fresh.reset([7])
    fields = ("seeds", "numbers", "step", "noise", "p_ref_next_kw", "state", "measured")
    for name in fields:
        after = getattr(batch.now, name)
        for env_index in (0, 2):
            assert_same(of_env(after, env_index), of_env(getattr(before, name), env_index))
        assert_same(of_env(after, 1), of_env(getattr(fresh.now, name), 0))
    for name in ("observation", "reward", "terminated", "truncated", "cost_j", "trace_start"):
        assert_same(getattr(begun, name)[1], getattr(first, name)[0])
        assert_same(getattr(begun, name)[[0, 2]], getattr(before.transition, name)[[0, 2]])
    assert begun.state is batch.now.state
    # And it goes on as if it had always been so.
    for _ in range(2):
        action = rng.uniform(-1, 1, (3, 10))
        assert_same(batch.step(action).observation[1], fresh.step(action[1:2]).observation[0])


def test_what_is_measured_is_the_voltage_plus_the_episodes_own_noise():
    scenario = make_scenario("ieee33-weak", horizon=3, sensing={"noise_pu": 0.002})
    simulation = Simulation(scenario, 2)
    simulation.reset([4, 5])
    for step in range(4):
        now = simulation.now
        drawn = random.standard(now.episode.key, random.MEASUREMENT, np.full(2, step), 7)
        np.testing.assert_array_equal(now.measured[-1], now.state.v_agent_pu + 0.002 * drawn)
        simulation.step(np.zeros((2, 10)))


def test_a_collapse_at_the_reset_ends_the_episode_with_its_first_step():
    scenario = make_scenario("toy6", datacenters={"p_rated_kw": 250_000.0}, horizon=5)
    simulation = Simulation(scenario, 1)
    begun = simulation.reset([0])
    assert not begun.converged[0]
    assert not begun.terminated[0]
    assert not begun.truncated[0]
    assert begun.cost_j[0] == begun.reward[0] == 0.0
    assert not simulation.now.over[0]
    ended = simulation.step(np.zeros((1, 4)))
    assert ended.terminated[0]
    assert not ended.truncated[0]
    assert ended.reward[0] == -ended.cost_j[0] < 0.0
    assert simulation.now.over[0]


def test_the_episode_is_over_after_its_last_step_and_no_sooner():
    simulation = Simulation(make_scenario("toy6", horizon=3), 2)
    found = [simulation.reset([0, 1])] + [simulation.step(np.zeros((2, 4))) for _ in range(3)]
    assert [t.truncated.tolist() for t in found] == [[False] * 2] * 3 + [[True] * 2]
    assert not any(t.terminated.any() for t in found)
    assert simulation.now.over.tolist() == [True, True]


def test_local_rewards_are_minus_each_agents_cost():
    simulation = Simulation(make_scenario("toy6", horizon=3, reward="local"), 2)
    simulation.reset([0, 1])
    found = simulation.step(np.ones((2, 4)))
    assert found.reward.shape == (2, 3)
    assert (found.reward < 0.0).all()
    assert found.cost_j.shape == (2,)


def test_what_cannot_be_restored_or_stepped_is_refused():
    simulation = Simulation(make_scenario("toy6"), 2)
    assert not simulation.has_begun
    with pytest.raises(RuntimeError, match="has not been reset; call reset"):
        simulation.step(np.zeros((2, 4)))
    simulation.reset([0, 1])
    assert simulation.has_begun
    saved = simulation.now
    with pytest.raises(ValueError, match="restore takes what save"):
        simulation.restore({})  # pyright: ignore[reportArgumentType]
    for other, message in (
        (Simulation(make_scenario("toy6"), 3), "the snapshot has 3 environments, this one 2"),
        (Simulation(make_scenario("toy6", horizon=9), 2), "a scenario with another horizon"),
    ):
        other.reset([0] * other.n_env)
        with pytest.raises(ValueError, match=message):
            simulation.restore(other.now)
    assert simulation.now is saved
    simulation.step(np.zeros((2, 4)))
    simulation.restore(saved)
    assert simulation.now is saved
    assert simulation.transition is saved.transition


def test_a_trace_that_is_too_short_is_refused_where_the_simulation_is_made():
    short = PowerTrace([0.0, 50.0], [1.0, 1.0], "short")
    with pytest.raises(TraceError, match=r"'short' lasts 50 s"):
        Simulation(make_scenario("toy6", trace=(short,), horizon=100), 1)
