"""Score a controller, with uncertainty: its share of the improvement from the tuned droop to perfect foresight.

    score    = mean(J_droop - J) / mean(J_droop - J_hindsight)        0: the tuned droop, 1: hindsight
    J saved  = mean(J_droop - J) / mean(J_droop)                      how much of the cost that is

The score is a ratio of means over episodes, since ratios of single episodes become very large where foresight gains
little. Intervals are studentised bootstraps over episodes, with the standard error of a ratio by the delta method
(B. Efron and R. J. Tibshirani, "An introduction to the bootstrap", 1993, chapter 12). With fewer than 8 episodes,
whose resamples carry little information, they are Student's t intervals. Over training seeds the variances between
seeds and between episodes add up. Decision 0028 reports the measured coverage of both.

The interquartile mean is that of R. Agarwal et al., "Deep reinforcement learning at the edge of the statistical
precipice", NeurIPS 2021: the mean of the middle half.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtrit
from scipy.stats import trim_mean

from dcgrid_env import Scenario
from dcgrid_env.baselines.laws.constant_set_points import agents_choose_set_points

REFERENCE = "droop-tuned"
"""The controller of score 0."""
STATIC = ("constant-q-tuned", "placement-tuned", "static-tuned")
"""Rules without measurements, see :func:`static_rules`."""
SPLIT = "test"
"""Split of the episodes that a score is computed on."""
PUBLISHED_EPISODES = 32
"""Minimum number of episodes of a published score."""
SAVED = "J saved, %"
"""Column name of the share of the reference's cost that a controller saves."""
IS_NO_BOUND = (
    "A score of 1 is the best known cost of each episode, found by a search of that episode and by controllers. It is "
    "not a bound: a controller may score more than 1."
)
"""Note on scores where the best known cost replaces hindsight."""
RESAMPLES = 10_000
LEVEL = 0.95
_FEWEST_RESAMPLED = 8


class Estimate(NamedTuple):
    """A figure and its 95 % interval."""

    value: float
    low: float
    high: float


class Score(NamedTuple):
    """Score of a policy over the same episodes as droop and hindsight."""

    score: Estimate
    saved_pct: Estimate
    """Mean of J_droop - J in per cent of the mean of J_droop."""
    difference: Estimate
    """Mean of J - J_droop: additional cost of the policy compared with the tuned droop."""
    interquartile_mean: float
    """Mean of J over the middle half of the episodes."""


def score(j: ArrayLike, j_droop: ArrayLike, j_hindsight: ArrayLike, seed: int = 0) -> Score:
    """Score a policy from its costs and those of the tuned droop and hindsight.

    Parameters
    ----------
    j, j_droop, j_hindsight
        Costs of the same episodes in the same order, (n_episode,) each.
    seed
        Seed of the resampling; the same costs and seed give the same interval.

    Raises
    ------
    ValueError
        If costs are not finite or differ in length, or there are fewer than 2 episodes. Also if hindsight does not
        beat the droop on average, since the score is then undefined.
    """
    costs = {"j": j, "j_droop": j_droop, "j_hindsight": j_hindsight}
    achieved, droop, best = (np.asarray(values, dtype=np.float64) for values in costs.values())
    for name, values in zip(costs, (achieved, droop, best), strict=True):
        if values.ndim != 1 or len(values) != len(achieved) or len(values) < 2:
            raise ValueError(f"score: {name} has shape {values.shape}; give one cost for each of at least 2 episodes")
        if not np.isfinite(values).all():
            raise ValueError(f"score: {name} is {values[~np.isfinite(values)][0]} in an episode; leave out what failed")
    if np.mean(droop - best) <= 0.0:
        raise ValueError(
            f"score: hindsight costs {best.mean():g} on average and the droop {droop.mean():g}; there is nothing "
            "between them to score"
        )
    gained = droop - achieved
    return Score(
        _ratio(gained, droop - best, seed),
        saved(achieved, droop, seed),
        _ratio(-gained, np.ones_like(gained), seed),
        float(trim_mean(achieved, 0.25)),
    )


def static_rules(scenario: Scenario) -> tuple[str, ...]:
    """Return the rules of ``STATIC`` that apply to a scenario: the minimum that a learner must beat.

    ``static-tuned`` applies where agents choose set points.
    """
    return STATIC if agents_choose_set_points(scenario) else STATIC[:-1]


def saved(j: ArrayLike, j_reference: ArrayLike, seed: int = 0) -> Estimate:
    """Compute :func:`saved_pct` with its interval, from the costs of at least 2 episodes, (n_episode,) each."""
    achieved, reference = (np.asarray(values, dtype=np.float64) for values in (j, j_reference))
    return _ratio(100.0 * (reference - achieved), reference, seed)


def saved_pct(j: ArrayLike, j_reference: ArrayLike) -> float:
    """Compute the cost saving of a controller relative to a reference, in per cent of the reference's mean cost."""
    return float(100.0 * (1.0 - np.asarray(j).mean() / np.asarray(j_reference).mean()))


def mean_over_seeds(seed_scores: Sequence[float], error: float, episodes: int) -> Estimate:
    """Compute the mean score over training seeds, with its interval for other seeds and episodes.

    The policies of all seeds drive the same episodes. The interval is Student's t. Its variance is that between seeds,
    divided by their number, plus that between episodes; the degrees of freedom are those of F. E. Satterthwaite,
    Biometrics Bulletin 2, 1946.

    Parameters
    ----------
    seed_scores
        Scores on the same episodes, at least 2.
    error
        Standard error of a score over episodes, see :func:`score_error`.
    episodes
        Number of episodes.
    """
    n = len(seed_scores)
    of_seeds, of_episodes = float(np.var(seed_scores, ddof=1)) / n, error**2
    value, variance = float(np.mean(seed_scores)), of_seeds + of_episodes
    if variance == 0.0:
        return Estimate(value, value, value)
    freedom = variance**2 / (of_seeds**2 / (n - 1) + of_episodes**2 / (episodes - 1))
    half = float(stdtrit(freedom, 0.5 + 0.5 * LEVEL)) * variance**0.5
    return Estimate(value, value - half, value + half)


def score_error(j: ArrayLike, j_droop: ArrayLike, j_hindsight: ArrayLike) -> float:
    """Compute the standard error of a score over episodes."""
    achieved, droop, best = (np.asarray(values, dtype=np.float64) for values in (j, j_droop, j_hindsight))
    return _error(droop - achieved, droop - best)


def _error(amount: np.ndarray, base: np.ndarray) -> float:
    """Compute the standard error of the ratio of two means by the delta method."""
    n, ratio = len(amount), amount.mean() / base.mean()
    return float(np.sqrt(((amount - ratio * base) ** 2).sum() / (n * (n - 1))) / abs(base.mean()))


def _ratio(amount: np.ndarray, base: np.ndarray, seed: int) -> Estimate:
    """Compute the ratio of two means over the same episodes, with its interval."""
    n, value, error = len(amount), float(amount.mean() / base.mean()), _error(amount, base)
    if error <= 1e-12 * abs(value):
        return Estimate(value, value, value)
    ends = np.array([0.5 + 0.5 * LEVEL, 0.5 - 0.5 * LEVEL])
    if n < _FEWEST_RESAMPLED:
        steps = stdtrit(n - 1, ends)
    else:
        weights = _resamples(n, seed)
        mean = weights @ base
        with np.errstate(divide="ignore", invalid="ignore"):  # a resample may have nothing to gain
            ratios = (weights @ amount) / mean
            squares = weights @ amount**2 - 2.0 * ratios * (weights @ (amount * base)) + ratios**2 * (weights @ base**2)
            errors = np.sqrt(np.maximum(squares, 0.0) / (n - 1)) / np.abs(mean)
        known = np.isfinite(errors) & (errors > 1e-6 * error)  # not an episode drawn n times
        steps = np.quantile((ratios[known] - value) / errors[known], ends)
    low, high = (value - error * steps).tolist()
    return Estimate(value, low, high)


@lru_cache(maxsize=4)
def _resamples(n: int, seed: int) -> np.ndarray:
    """Share of each episode in each resample, (RESAMPLES, n)."""
    return np.random.default_rng(seed).multinomial(n, np.full(n, 1.0 / n), RESAMPLES) / n
