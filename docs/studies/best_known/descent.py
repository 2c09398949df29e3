"""Descent along the gradient by every action at once, for long episodes in which nothing is switched by the grid.

The optimiser is Adam (D. P. Kingma and J. Ba, arXiv 1412.6980) with a rate that falls to 0. The cost has kinks, so a
step may increase it. The result is the best trajectory that the environment itself has driven.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.baselines.recorded_actions import rounded
from docs.studies.best_known.driving import driven
from docs.studies.best_known.gradient import CostGradient

RATE = 6e-3
"""Largest change of an action in an update at the beginning, about."""
EVERY = 4
"""Updates from one drive of the environment to the next, which gives costs and the states of the windows' starts."""
_MEMORY, _MEMORY_OF_SQUARES = 0.9, 0.98


class Descent:
    """Rounds of ``EVERY`` updates over some episodes.

    Parameters
    ----------
    scenario, seeds
        The episodes.
    actions
        Where to begin, (step, episode, n_action).
    rounds
        How many rounds there will be.
    """

    def __init__(self, scenario: Scenario, seeds: Sequence[int], actions: np.ndarray, rounds: int):
        self._scenario, self._seeds, self._updates = scenario, list(seeds), rounds * EVERY
        self._gradient = CostGradient(scenario, seeds)
        self._at, self._done = rounded(actions), 0
        self._mean, self._square = np.zeros_like(self._at), np.zeros_like(self._at)
        self.actions = self._at
        self.J, self._states = driven(scenario, seeds, self._at, self._gradient.starts)
        self._gradient.settle(self._at, self._states)

    def advance(self) -> None:
        """Make one round."""
        for _ in range(EVERY):
            self._update()
        at = rounded(self._at)
        j, self._states = driven(self._scenario, self._seeds, at, self._gradient.starts)
        better = j < self.J
        self.J = np.where(better, j, self.J)
        self.actions = np.where(better[:, None], at, self.actions)

    def _update(self) -> None:
        slope = self._gradient(self._at, self._states)
        self._mean = _MEMORY * self._mean + (1.0 - _MEMORY) * slope
        self._square = _MEMORY_OF_SQUARES * self._square + (1.0 - _MEMORY_OF_SQUARES) * slope * slope
        rate = RATE * (1.0 - self._done / self._updates)
        self._done += 1
        mean = self._mean / (1.0 - _MEMORY**self._done)
        square = self._square / (1.0 - _MEMORY_OF_SQUARES**self._done)
        scale = np.sqrt(square) + 0.2 * np.sqrt(square.mean(axis=0, keepdims=True)) + 1e-6
        self._at = np.clip(self._at - rate * mean / scale, -1.0, 1.0)
