"""How much of the way from the tuned droop to perfect foresight a policy goes, with its uncertainty.

    score = mean(J_droop - J) / mean(J_droop - J_hindsight)        0: the tuned droop, 1: hindsight

A ratio of means over episodes: ratios of single episodes explode where foresight has little to gain. Intervals are
paired percentile bootstraps over episodes (B. Efron and R. J. Tibshirani, "An introduction to the bootstrap", 1993),
where several training seeds are scored over seeds and episodes, each drawn anew by itself.
The interquartile mean is that of R. Agarwal et al., "Deep reinforcement learning at the edge of the statistical
precipice", NeurIPS 2021: the mean of the middle half.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import bootstrap, trim_mean

REFERENCE = "droop-tuned"
"""The controller of score 0."""
STATIC = ("constant-q-tuned", "placement-tuned")
"""Rules that measure nothing: the least that a learner must beat."""
SPLIT = "test"
"""The split whose episodes a score is over."""
RESAMPLES = 10_000
LEVEL = 0.95


class Estimate(NamedTuple):
    """A figure and its 95 % interval."""

    value: float
    low: float
    high: float


class Score(NamedTuple):
    """A policy over the same episodes as droop and hindsight."""

    score: Estimate
    difference: Estimate
    """Mean of J - J_droop: what the policy costs more than the tuned droop."""
    interquartile_mean: float
    """Mean of J over the middle half of the episodes."""


def score(j: ArrayLike, j_droop: ArrayLike, j_hindsight: ArrayLike, seed: int = 0) -> Score:
    """Score a policy.

    Parameters
    ----------
    j, j_droop, j_hindsight
        Costs of the same episodes in the same order, (n_episode,) each.
    seed
        Seed of the resampling; the same costs and seed give the same interval.

    Raises
    ------
    ValueError
        For costs that are not finite or of different lengths, fewer than 2 episodes, or a hindsight that on average
        does not beat the droop, against which there is nothing to score.
    """
    costs = {"j": j, "j_droop": j_droop, "j_hindsight": j_hindsight}
    own, droop, best = (np.asarray(values, dtype=np.float64) for values in costs.values())
    for name, values in zip(costs, (own, droop, best), strict=True):
        if values.ndim != 1 or len(values) != len(own) or len(values) < 2:
            raise ValueError(f"score: {name} has shape {values.shape}; give one cost for each of at least 2 episodes")
        if not np.isfinite(values).all():
            raise ValueError(f"score: {name} is {values[~np.isfinite(values)][0]} in an episode; leave out what failed")
    if np.mean(droop - best) <= 0.0:
        raise ValueError(
            f"score: hindsight costs {best.mean():g} on average and the droop {droop.mean():g}; there is nothing "
            "between them to score"
        )
    rng = np.random.default_rng(seed)
    return Score(
        _estimate(_share, (droop - own, droop - best), rng),
        _estimate(_mean, (own - droop,), rng),
        float(trim_mean(own, 0.25)),
    )


def score_over_seeds(j: ArrayLike, j_droop: ArrayLike, j_hindsight: ArrayLike, seed: int = 0) -> Estimate:
    """Score of an algorithm: the mean over its training seeds, with an interval over seeds and episodes.

    Seeds and episodes are crossed, every seed's policy drives the same episodes; a resample draws seeds and, apart from
    them, episodes with replacement, so that the interval holds for a further seed on further episodes. It has the width
    of five seeds at best: seeds that were not drawn say nothing of those that fail rarely.

    Parameters
    ----------
    j
        Costs of each seed's policy, (n_seed, n_episode).
    j_droop, j_hindsight, seed
        See :func:`score`.

    Raises
    ------
    ValueError
        For fewer than 2 seeds, and where :func:`score` raises it.
    """
    own = np.asarray(j, dtype=np.float64)
    if own.ndim != 2 or len(own) < 2:
        raise ValueError(
            f"score: j has shape {own.shape}; give costs of at least 2 training seeds, (n_seed, n_episode)"
        )
    value = float(np.mean([score(of_seed, j_droop, j_hindsight, seed).score.value for of_seed in own]))
    droop, best = np.asarray(j_droop, dtype=np.float64), np.asarray(j_hindsight, dtype=np.float64)
    rng = np.random.default_rng(seed)
    (n_seed, n_episode), drawn = own.shape, RESAMPLES
    of_seeds = rng.multinomial(n_seed, np.full(n_seed, 1.0 / n_seed), drawn) / n_seed
    of_episodes = rng.multinomial(n_episode, np.full(n_episode, 1.0 / n_episode), drawn) / n_episode
    gained = ((of_seeds @ (droop - own)) * of_episodes).sum(axis=1)
    low, high = np.quantile(gained / (of_episodes @ (droop - best)), [0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL])
    return Estimate(value, float(low), float(high))


def _share(gained: np.ndarray, possible: np.ndarray, axis: int = -1) -> np.ndarray:
    return gained.mean(axis=axis) / possible.mean(axis=axis)


def _mean(values: np.ndarray, axis: int = -1) -> np.ndarray:
    return values.mean(axis=axis)


def _estimate(statistic, samples: tuple[np.ndarray, ...], rng: np.random.Generator) -> Estimate:
    resampled = bootstrap(
        samples, statistic, n_resamples=RESAMPLES, paired=True, vectorized=True, confidence_level=LEVEL,
        method="percentile", rng=rng,
    )  # fmt: skip
    return Estimate(float(statistic(*samples)), *map(float, resampled.confidence_interval))
