"""Random figures of one feeder: hashes of its seed, by what they are for, so that they are the same everywhere.

The bits are those of ``core.random``. What passes through an exponential may differ in its last bits from one machine
to another; whoever publishes such a figure rounds it.
"""

from __future__ import annotations

import zlib

import numpy as np

SALT = np.uint64(zlib.crc32(b"random feeder"))


class Draws:
    """Draws for one attempt at a feeder.

    Parameters
    ----------
    seed
        Seed of the feeder, a whole number from 0 to 2^64 - 1.
    attempt
        Number of the attempt.
    """

    def __init__(self, seed: int, attempt: int):
        from dcgrid_env.core import random  # brings the compiler with it, so not on import

        self._hashes = random.bits
        self._key = random.keys(SALT, np.array([seed], np.uint64), np.array([attempt], np.uint64))
        self._stream = 100  # beyond those of episodes

    def bits(self, n: int) -> np.ndarray:
        """Return the next hashes, uint64, shape (n,); each call uses a separate stream."""
        self._stream += 1
        return self._hashes(self._key, self._stream, n)[0]

    def uniform(self, n: int) -> np.ndarray:
        """Even draws in [0, 1), (n,)."""
        return (self.bits(n) >> np.uint64(11)) * 2.0**-53

    def between(self, limits: tuple[float, float]) -> float:
        """One even draw between two limits."""
        low, high = limits
        return low + (high - low) * float(self.uniform(1)[0])

    def standard(self, n: int) -> np.ndarray:
        """Draws with mean 0 and variance 1, nearly normal, (n,)."""
        return (self.uniform(4 * n).reshape(n, 4).sum(axis=1) - 2.0) * np.sqrt(3.0)
