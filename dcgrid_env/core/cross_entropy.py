"""Cross-entropy method: search for the parameter vector of least cost without a derivative.

Candidates are drawn from a normal distribution with a diagonal covariance. The next distribution has the mean and the
standard deviation of the elites, the candidates of least cost. A decreasing extra deviation keeps it from collapsing
early.

Reference: I. Szita and A. Lorincz, "Learning Tetris using the noisy cross-entropy method", Neural Computation 18(12),
2006.
"""

from __future__ import annotations

import numpy as np

EXTRA_UNTIL = 0.7
"""Fraction of the search after which the extra deviation is 0."""


class CrossEntropy:
    """Distribution of the candidates.

    Parameters
    ----------
    mean
        Initial mean, (n,).
    std
        Initial standard deviation of every parameter.
    extra_std
        Initial extra deviation, which decreases linearly.
    elites
        Number of candidates that determine the next distribution.
    """

    def __init__(self, mean: np.ndarray, std: float, extra_std: float, elites: int):
        self.mean, self.std = mean.astype(np.float64), np.full(len(mean), float(std))
        self.extra_std, self.elites = extra_std, elites

    def candidates(self, rng: np.random.Generator, population: int) -> np.ndarray:
        """Draw candidates, (population, n), float32; the first one is the mean."""
        drawn = self.mean + self.std * rng.standard_normal((population, len(self.mean)))
        drawn[0] = self.mean
        return drawn.astype(np.float32)

    def update(self, candidates: np.ndarray, costs: np.ndarray, done: float) -> None:
        """Move the distribution to the elites.

        Parameters
        ----------
        candidates
            (population, n)
        costs
            Cost of each candidate, (population,).
        done
            Completed fraction of the search, 0 to 1.
        """
        elites = candidates[np.argsort(costs, kind="stable")[: self.elites]].astype(np.float64)
        extra = self.extra_std * max(0.0, 1.0 - done / EXTRA_UNTIL)
        self.mean, self.std = elites.mean(0), np.hypot(elites.std(0, ddof=1), extra)
