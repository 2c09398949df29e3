"""Random numbers by counting: each figure is a hash of (key, stream, step, index), so nothing is drawn ahead.

The hash is the output function of SplitMix64 (G. L. Steele, D. Lea, C. H. Flood, "Fast splittable pseudorandom number
generators", OOPSLA 2014). A standard draw is the scaled sum of four 16-bit uniforms of one hash (mean 0, variance 1,
excess kurtosis -0.3, never beyond 3.47): integers and one multiplication, hence the same bits on every machine.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled

PLACEMENT, TRACE_ROW, TRACE_START, LOAD, MEASUREMENT, CORRELATION, SUN, FAULT, HOUR, SAG, LOAD_TARGET = range(1, 12)
"""Random streams, one for each purpose of a draw."""

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_M1, _M2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_MASK = np.uint64(0xFFFF)
_SCALE = 1.0 / np.sqrt(4 * (65536.0**2 - 1) / 12)


@compiled(inner=True)
def _mix(x):
    x = (x ^ (x >> np.uint64(30))) * _M1
    x = (x ^ (x >> np.uint64(27))) * _M2
    return x ^ (x >> np.uint64(31))


@compiled(inner=True)
def _hash(key, stream, step, index):
    counter = (np.uint64(stream) << np.uint64(56)) | (np.uint64(step) << np.uint64(24)) | np.uint64(index)
    return _mix(_mix(key + _GOLDEN) + (counter + np.uint64(1)) * _GOLDEN)


@compiled(inner=True)
def _standard(h):
    total = (
        (h & _MASK) + ((h >> np.uint64(16)) & _MASK) + ((h >> np.uint64(32)) & _MASK) + ((h >> np.uint64(48)) & _MASK)
    )
    return (float(total) - 2.0 * 65535.0) * _SCALE


@compiled
def keys(salt, seeds, episodes):
    """One key per row, uint64, from the split's salt, the row's seed and the episode's number since that seed."""
    out = np.empty(seeds.shape[0], np.uint64)
    for i in range(seeds.shape[0]):
        out[i] = _mix(_mix(_mix(salt + _GOLDEN) + seeds[i] * _GOLDEN) + (episodes[i] + np.uint64(1)) * _GOLDEN)
    return out


@compiled
def bits(key, stream, n):
    """Hashes of one stream, shape (row, n), uint64."""
    out = np.empty((key.shape[0], n), np.uint64)
    for i in range(key.shape[0]):
        for j in range(n):
            out[i, j] = _hash(key[i], stream, 0, j)
    return out


def uniform(key, stream, n):
    """Uniform draws in [0, 1), (row, n): the upper 53 bits of a hash, so that none rounds to 1."""
    return (bits(key, stream, n) >> np.uint64(11)) * 2.0**-53


@compiled
def standard(key, stream, step, n):
    """Standard draws (mean 0, variance 1) of each row's ``step``, shape (row, n)."""
    out = np.empty((key.shape[0], n))
    for i in range(key.shape[0]):
        for j in range(n):
            out[i, j] = _standard(_hash(key[i], stream, step[i], j))
    return out


@compiled(nogil=True)
def load_step(key, step, z, share, rho, sigma, p_base, q_base, q_fixed, z_out, p_out, q_out):
    """One step of the buses' AR(1) load noise: z' = rho z + sqrt(1 - rho^2) e, and the loads.

    They are base share (1 + sigma z'), share (row,) that of the peak at the row's time of day.

    At step 0 z' is a fresh draw, so that the process starts in its stationary state. Shapes (row, bus); ``q_fixed``
    is added to q without noise (capacitors). Returns 0 (rows that failed).
    """
    fresh = np.sqrt(1.0 - rho * rho)
    for i in range(key.shape[0]):
        for j in range(p_base.shape[0]):
            e = _standard(_hash(key[i], LOAD, step[i], j))
            value = e if step[i] == 0 else rho * z[i, j] + fresh * e
            z_out[i, j] = value
            p_out[i, j] = share[i] * (p_base[j] * (1.0 + sigma * value))
            q_out[i, j] = share[i] * (q_base[j] * (1.0 + sigma * value)) + q_fixed[j]
    return 0
