"""The damping of each agent: the search finds one that neither creeps nor overshoots."""

import numpy as np
import pytest

from dcgrid_env.baselines.model_aided.damping import settled

TARGET = np.random.default_rng(0).normal(0.0, 0.4, (20, 2))


@pytest.mark.parametrize("begin", [0.5, 0.8, 1.6])
def test_it_comes_near_what_reaches_the_target_at_once(begin):
    right = np.array([1.0, 0.7])  # a step of (target - share) right / damping

    def respond(damping, share):
        return share + (TARGET - share) * right / damping

    before = np.array([begin, begin])
    found = settled(before, np.zeros_like(TARGET), respond)
    assert (np.abs(np.log(found / right)) < 0.5 * np.abs(np.log(before / right)) + 0.05).all()


def test_steps_that_reverse_raise_it_and_an_agent_that_stands_still_keeps_it():
    def respond(damping, share):
        return share + (TARGET - share) * np.array([1.8, 0.0]) / damping

    found = settled(np.array([0.8, 0.8]), np.zeros_like(TARGET), respond)
    assert found[0] > 1.2
    assert found[1] == 0.8
