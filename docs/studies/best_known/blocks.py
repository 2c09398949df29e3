"""Search over blocks of actions: a beam of trajectories, each block of steps tried in many ways from where it begins.

A trajectory is improved from its first block to its last. A few trajectories of an episode are kept, each is copied.
Every copy takes other actions in the block and the best known ones afterwards. Its cost until some steps after the
block decides whether it is kept. The environment steps every copy, so taps, trips and returns are exact. Some copies
follow the negative gradient of the trajectory by random lengths in random channels, the others change at random. The
best known trajectory is always kept, so no pass makes the cost higher.

The search is a beam search (B. T. Lowerre, 1976) over the perturbations of a known trajectory.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.baselines.recorded_actions import rounded
from docs.studies.best_known.driving import begun, driven
from docs.studies.best_known.gradient import CostGradient

KEPT, COPIES = 4, 16
"""Trajectories that are kept of an episode, and copies of each."""
BLOCK, AHEAD = 10, 30
"""Steps of a block, and those behind it that it is judged by."""
_DOWNHILL = 0.6
"""Share of the copies that go down the gradient."""


class BlockSearch:
    """Passes over some episodes, each of which begins with the best trajectories so far.

    Parameters
    ----------
    scenario, seeds
        The episodes.
    actions
        Where to begin, (step, episode, n_action).
    """

    def __init__(self, scenario: Scenario, seeds: Sequence[int], actions: np.ndarray):
        self._scenario, self._seeds = scenario, list(seeds)
        self._gradient = CostGradient(scenario, seeds)
        self._passes = 0
        self._draws = [np.random.default_rng([7, seed]) for seed in seeds]
        self.actions = rounded(actions)
        self.J, _ = driven(scenario, seeds, self.actions)

    def advance(self) -> None:
        """Make one pass."""
        _, states = driven(self._scenario, self._seeds, self.actions, self._gradient.starts)
        slope = self._gradient(self.actions, states)
        scale = np.sqrt((slope * slope).mean(axis=0, keepdims=True)) + 1e-12
        self._pass(np.clip(-slope / scale, -3.0, 3.0))
        self._passes += 1

    def _pass(self, downhill: np.ndarray) -> None:
        horizon, n_episode, n = self.actions.shape
        copied = np.repeat(self.actions, KEPT * COPIES, axis=1)
        downhill = np.repeat(downhill, KEPT * COPIES, axis=1)
        kept = begun(self._scenario, self._seeds)[0].fork(np.repeat(np.arange(n_episode), KEPT))
        found = np.zeros((horizon, n_episode * KEPT, n))
        offset = int(np.random.default_rng([8, self._passes]).integers(BLOCK))
        cuts = sorted({0, *range(offset, horizon, BLOCK), horizon})
        for begin, end in pairwise(cuts):
            tried = kept.fork(np.repeat(np.arange(n_episode * KEPT), COPIES))
            block = self._tried(copied[begin:end], downhill[begin:end])
            for action in block:
                tried.step(action)
            behind = tried.fork(np.arange(n_episode * KEPT * COPIES))
            for action in copied[end : end + AHEAD]:
                behind.step(action)
            best = _best(behind.cost.reshape(n_episode, KEPT * COPIES))
            found = found[:, best // COPIES]
            found[begin:end] = block[:, best]
            kept = tried.fork(best)
        j = kept.cost.reshape(n_episode, KEPT) / horizon
        least = np.arange(n_episode) * KEPT + j.argmin(axis=1)
        self.actions, self.J = found[:, least], j.min(axis=1)

    def _tried(self, block: np.ndarray, downhill: np.ndarray) -> np.ndarray:
        """What the copies do in a block, (step, copy, n_action); the first of each trajectory as it was."""
        parts = [_change(draw, len(block), block.shape[2]) for draw in self._draws]
        noise, length = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
        on = np.concatenate([part[2] for part in parts], axis=1)
        noise[::COPIES], length[::COPIES] = 0.0, 0.0
        return rounded(block + (noise + length * downhill) * on[..., None])


def _change(draw: np.random.Generator, steps: int, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw offsets and lengths of gradient steps, (copy, n), and when they apply, (step, copy), for one episode."""
    count = KEPT * COPIES
    spread = 0.3 * 10.0 ** draw.uniform(-1.5, 0.3, (count, 1))
    few = np.where(draw.random((count, 1)) < 0.5, 1.5 / n, 0.3)
    noise = draw.standard_normal((count, n)) * spread * (draw.random((count, n)) < few)
    length = 10.0 ** draw.uniform(-2.5, -0.3, (count, 1))
    length = length * (draw.random((count, n)) < draw.choice([0.15, 0.5, 1.0], (count, 1)))
    down = draw.random((count, 1)) < _DOWNHILL
    ends = np.sort(draw.integers(0, steps, (2, count)), axis=0)
    whole = draw.random(count) < 0.5
    first, last = np.where(whole, 0, ends[0]), np.where(whole, steps, ends[1])
    step = np.arange(steps)[:, None]
    return noise * ~down, length * down, (step >= first) & (step <= last)


def _best(cost: np.ndarray) -> np.ndarray:
    """Positions of the copies of each episode that are kept, the untouched best trajectory as the first of them."""
    order = np.argsort(cost, axis=1, kind="stable")
    others = np.array([row[row != 0][: KEPT - 1] for row in order])
    own = np.concatenate((np.zeros((len(cost), 1), np.int64), others), axis=1)
    return (own + np.arange(len(cost))[:, None] * cost.shape[1]).ravel()
