"""The score: its two ends, its interval, and what cannot be scored."""

import numpy as np
import pytest

from dcgrid_env.baselines.score import score, score_over_seeds

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


def test_one_seed_five_times_has_the_interval_over_episodes():
    own = 0.4 * DROOP + 0.6 * BEST + RNG.normal(0.0, 0.2, 100)
    one, many = score(own, DROOP, BEST).score, score_over_seeds([own] * 5, DROOP, BEST)
    assert many.value == pytest.approx(one.value)
    assert many[1:] == pytest.approx(one[1:], abs=0.01)


@pytest.mark.slow
def test_the_interval_over_seeds_covers_the_algorithm_that_over_episodes_misses():
    """Seeds that lie far apart: the mean over all seeds that could be is 0.5."""
    covered, missed = 0, 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        each = rng.normal(0.5, 0.2, 10)
        gained = each[:, None] * (DROOP - BEST)
        found = score_over_seeds(DROOP - gained, DROOP, BEST, seed)
        assert found.value == pytest.approx(each.mean())
        covered += found.low < 0.5 < found.high
        of_mean = score(DROOP - gained.mean(axis=0), DROOP, BEST, seed).score
        missed += not of_mean.low < 0.5 < of_mean.high
    assert covered >= 48  # a percentile bootstrap over ten is somewhat narrow
    assert missed >= 40


def test_the_score_over_seeds_takes_several_and_says_so():
    assert score_over_seeds([DROOP, BEST], DROOP, BEST) == score_over_seeds([DROOP, BEST], DROOP, BEST)
    with pytest.raises(ValueError, match=r"j has shape \(1, 100\); give costs of at least 2 training seeds"):
        score_over_seeds([DROOP], DROOP, BEST)
    with pytest.raises(ValueError, match="j is nan in an episode"):
        score_over_seeds([DROOP, np.full(100, np.nan)], DROOP, BEST)
