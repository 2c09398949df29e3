"""The score: its two ends, its interval, and what cannot be scored."""

import numpy as np
import pytest

from dcgrid_env.baselines.score import mean_over_seeds, saved_pct, score, score_error

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


@pytest.mark.parametrize("n", [8, 32])
@pytest.mark.slow
def test_the_interval_covers_the_truth_as_often_as_it_says(n):
    """Of 95 %: with 8 episodes a percentile bootstrap and BCa both cover the truth 0.88 of the time."""
    rng, covered, runs = np.random.default_rng(1), 0, 500
    for _ in range(runs):
        possible = rng.normal(1.0, 0.3, n)
        gained = 0.7 * possible + rng.normal(0.0, 0.2, n)
        found = score(5.0 - gained, np.full(n, 5.0), 5.0 - possible).score
        assert found.low < found.value < found.high
        covered += found.low < 0.7 < found.high
    assert 0.92 <= covered / runs <= 0.98


def test_one_episode_with_headroom_among_eight_has_an_interval():
    """Resamples without that episode have nothing to gain, and no ratio."""
    droop = np.ones(8)
    found = score(droop - np.eye(8)[0] * 0.4, droop, droop - np.eye(8)[0] * 0.5)
    assert found.score.value == pytest.approx(0.8)
    assert np.isfinite(found.score).all()


def test_few_episodes_have_the_interval_of_student():
    """By hand: gains 1 and 2 of 2 each, a ratio of 0.75; standard error 0.25, and t of one degree of freedom 12.706."""
    found = score([2.0, 1.0], [3.0, 3.0], [1.0, 1.0]).score
    assert found == pytest.approx((0.75, 0.75 - 12.7062 * 0.25, 0.75 + 12.7062 * 0.25), rel=1e-5)


def test_the_share_of_j_that_is_saved():
    found = score(0.25 * DROOP + 0.75 * BEST, DROOP, BEST).saved_pct
    assert found.value == pytest.approx(75.0 * (1.0 - BEST.mean() / DROOP.mean()))
    assert found.value == pytest.approx(saved_pct(0.25 * DROOP + 0.75 * BEST, DROOP))
    assert found.low < found.value < found.high
    assert saved_pct(3.0, 4.0) == pytest.approx(25.0)


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


def test_seeds_that_agree_leave_the_uncertainty_of_episodes():
    own = 0.4 * DROOP + 0.6 * BEST + RNG.normal(0.0, 0.2, 100)
    one, many = score(own, DROOP, BEST).score, mean_over_seeds([0.6] * 5, score_error(own, DROOP, BEST), 100)
    assert many.value == pytest.approx(0.6)
    assert many.high - many.low == pytest.approx(one.high - one.low, rel=0.1)
    assert mean_over_seeds([0.6] * 5, 0.0, 100) == (0.6, 0.6, 0.6)


def test_seeds_alone_have_the_interval_of_student():
    """By hand: 0.4 and 0.6, mean 0.5, standard error 0.1, and t of one degree of freedom 12.706."""
    assert mean_over_seeds([0.4, 0.6], 0.0, 100) == pytest.approx((0.5, 0.5 - 1.27062, 0.5 + 1.27062), rel=1e-5)


def test_the_interval_over_seeds_covers_the_algorithm():
    """Five seeds that lie far apart, of which the mean over all that could be is 0.5."""
    rng, covered, runs = np.random.default_rng(0), 0, 400
    for _ in range(runs):
        found = mean_over_seeds((rng.normal(0.5, 0.2, 5) + rng.normal(0.0, 0.05)).tolist(), 0.05, 100)
        covered += found.low < 0.5 < found.high
    assert 0.92 <= covered / runs <= 0.98
