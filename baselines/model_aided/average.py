"""Average an agent's recent voltages if measurements have noise.

An agent's E, its voltage without its own part, changes by w from one step to the next, and is measured with noise n.
If both are independent of the past, the best estimate is an average that each measurement moves by a share K of the
difference. With q = E[w^2] / E[n^2],

    K = (sqrt(q^2 + 4 q) - q) / 2        error variance K E[n^2]

This is the steady state of the Kalman filter of one state (R. E. Kalman, "A new approach to linear filtering and
prediction problems", 1960). K is at least 0.1, as the others' reactive power moves E too. The first t measurements
count alike as long as 1 / t is more than K.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env.baselines.model_aided.knowledge import Commissioned
from dcgrid_env.core.arrays import Array

_LEAST = 0.1


def newest_weight(noise_pu: float, change_pu: np.ndarray) -> np.ndarray:
    """K of each agent, (n,), from the noise's standard deviation, p.u., and changes of E in a step, p.u., (m, n)."""
    q = (change_pu**2).mean(axis=0) / noise_pu**2
    return np.maximum(0.5 * (np.sqrt(q * q + 4.0 * q) - q), _LEAST)


class Average:
    """Average of what agents have seen since the beginning; on NumPy arrays or tensors."""

    def __init__(self) -> None:
        self._mean: Any = None
        self._count = 0

    def __call__(self, known: Commissioned, e_own: Array) -> Array:
        """The average, p.u., (m, n), with the newest E, (m, n), in it; ``known`` is of the arrays' kind."""
        self._count += 1
        if self._mean is None:
            self._mean = e_own
        else:
            self._mean = self._mean + known.newest.clip(1.0 / self._count, None) * (e_own - self._mean)
        return self._mean
