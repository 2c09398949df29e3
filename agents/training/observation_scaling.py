"""Means and standard deviations by which policies scale what rows observe."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env.agents.training.row_batch import RowBatch
from dcgrid_env.agents.training.row_views import Rows, make_rows

CLIP = 10.0
"""Largest absolute value of a scaled observation."""
ENVS, SEED = 8, 1 << 40
"""Environments of the episode by which observations are scaled, and the seed of the first."""
SMALLEST_SPREAD = 1e-2
"""Least standard deviation that an observation is divided by."""


class Scaling(NamedTuple):
    """Mean and standard deviation of each entry of a row's observation, float64, (n_observation,)."""

    mean: np.ndarray
    std: np.ndarray

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """Return scaled observations in [-10, 10], float32, (..., n_observation)."""
        return ((observations - self.mean) / self.std).clip(-CLIP, CLIP).astype(np.float32)


def observation_scaling(rows: Rows) -> Scaling:
    """Return the scaling by a training episode of eight environments with small random actions.

    It is the same for each split of a scenario, so that a policy is tested with the scaling of its training.
    """
    rows = make_rows(rows.scenario.replace(split="train"), rows.form, action_repeat=rows.action_repeat)
    batch, rng = RowBatch(rows, ENVS), np.random.default_rng(0)
    joint, _ = batch.reset(seed=SEED)
    seen = [rows.observed(joint)]
    offset = 0.3 * rng.standard_normal((len(seen[0]), rows.n_action))
    for _ in range(rows.n_decisions):
        action = np.clip(offset + 0.3 * rng.standard_normal(offset.shape), -1.0, 1.0).astype(np.float32)
        joint, *_ = batch.advance(joint, action)
        seen.append(rows.observed(joint))
    figures = np.concatenate(seen).astype(np.float64)
    return Scaling(figures.mean(0), np.maximum(figures.std(0), SMALLEST_SPREAD))
