"""The score: its two ends, its interval, and what cannot be scored."""

import numpy as np
import pytest

from dcgrid_env.baselines.score import score

RNG = np.random.default_rng(0)
DROOP = RNG.uniform(1.0, 5.0, 100)
BEST = DROOP - RNG.exponential(0.5, 100)


def test_droop_is_0_and_hindsight_is_1():
    for costs, wanted in ((DROOP, 0.0), (BEST, 1.0), (0.25 * DROOP + 0.75 * BEST, 0.75)):
        found = score(costs, DROOP, BEST)
        assert found.score == pytest.approx((wanted, wanted, wanted), abs=1e-12)
        assert found.difference.value == pytest.approx((costs - DROOP).mean())


def test_it_is_a_ratio_of_means():
    # One episode with hardly anything to gain, in which the policy loses: its own ratio is -100.
    droop, best, own = np.array([1.0, 3.0]), np.array([0.999, 1.0]), np.array([1.1, 1.5])
    assert score(own, droop, best).score.value == pytest.approx((-0.1 + 1.5) / (0.001 + 2.0))


def test_the_interval_covers_the_truth_as_often_as_it_says():
    covered = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        possible = rng.exponential(1.0, 60)
        gained = 0.6 * possible + rng.normal(0.0, 0.3, 60)
        found = score(5.0 - gained, np.full(60, 5.0), 5.0 - possible, seed).score
        assert found.low < found.value < found.high
        covered += found.low < 0.6 < found.high
    assert 87 <= covered <= 100


def test_pairs_make_it_sharp():
    # A policy that is better by the same everywhere: the episodes' own spread is not its uncertainty.
    found = score(DROOP - 0.1, DROOP, BEST)
    assert found.difference == pytest.approx((-0.1, -0.1, -0.1))
    again = score(DROOP - 0.1, DROOP, BEST)
    assert found == again


def test_the_interquartile_mean_is_that_of_the_middle_half():
    costs = np.array([100.0, 1.0, 2.0, 3.0, 4.0, -50.0, 2.5, 3.5])
    assert score(costs, np.full(8, 9.0), np.zeros(8)).interquartile_mean == pytest.approx((2.0 + 2.5 + 3.0 + 3.5) / 4)


@pytest.mark.parametrize(
    ("j", "j_droop", "j_hindsight", "message"),
    [
        ([1.0, np.nan], [2.0, 2.0], [1.0, 1.0], "j is nan in an episode"),
        ([1.0, 1.0], [2.0, 2.0, 2.0], [1.0, 1.0], r"j_droop has shape \(3,\)"),
        ([1.0], [2.0], [1.0], r"j has shape \(1,\)"),
        ([1.0, 1.0], [2.0, 2.0], [2.0, 2.5], "nothing between"),
        ([1.0, 1.0], [2.0, 3.0], [3.0, 2.0], "nothing between"),
    ],
)
def test_what_cannot_be_scored_is_named(j, j_droop, j_hindsight, message):
    with pytest.raises(ValueError, match=message):
        score(j, j_droop, j_hindsight)
