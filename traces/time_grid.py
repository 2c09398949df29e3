"""Shared values of all generators: the 0.1 s grid, the random stream of a seed, and the idle power of a site."""

import dataclasses
import math

import numpy as np

from dcgrid_env.traces.checks import FloatArray, TraceError, require_positive
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.trace import PowerTrace, RequestTimes

GRID_S = 0.1
"""Resolution of generated traces, s."""

IDLE_SHARE = 0.23
"""Idle floor of a data centre as a share of its rating (recorded by Chen and Zhang: 546 of 2395 W)."""

AWAKE_SHARE = 0.275
"""Upper idle plateau: the GPUs hold their clocks though nothing runs (recorded 0.27 to 0.28 of the peak)."""


def grid_steps(duration_s: float) -> int:
    """Steps of the grid that cover `duration_s`; TraceError unless it is finite and above zero."""
    duration_s = require_positive(duration_s, "duration_s", "give the length of the trace in seconds")
    return max(1, math.ceil(duration_s / GRID_S - 1e-9))


def check_range(params: object, field: dataclasses.Field, limits: tuple[float, float]) -> None:
    """Check a field of a generator's parameters.

    A field whose default is a pair holds the range from which is drawn, any other a number.

    Raises
    ------
    TraceError
        Unless the number, or both ends of the rising pair, lie within the limits, both allowed.
    """
    value, (low, high) = getattr(params, field.name), limits
    where = f"{type(params).__name__}.{field.name} = {value}"
    if not isinstance(field.default, tuple):
        if isinstance(value, tuple) or not low <= value <= high:
            raise TraceError(f"{where} is not in {low:g} to {high:g}")
    elif not (isinstance(value, tuple) and len(value) == 2 and low <= value[0] <= value[1] <= high):
        raise TraceError(f"{where} is not a rising pair within {low:g} to {high:g}")


def stream(generator: str, seed: int) -> np.random.Generator:
    """Random stream of a generator's seed; two generators with the same seed are independent.

    Raises
    ------
    TraceError
        If the seed is not an integer of at least 0.
    """
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise TraceError(f"seed = {seed!r} of generator {generator!r} is not an integer of at least 0")
    return np.random.default_rng([int.from_bytes(generator.encode(), "little"), int(seed)])


def idle_draw(rng: np.random.Generator, n_steps: int) -> FloatArray:
    """Draw of an idle site: an upper plateau with short falls towards the floor, redrawn every second.

    The law of the level, floor + (plateau - floor) u^(1/4.5), and one full fall in 50 are read off the recording.

    Returns
    -------
    (n_steps,) float64 in [IDLE_SHARE, AWAKE_SHARE], share of rating
    """
    block = round(1.0 / GRID_S)
    u = rng.random(n_steps // block + 2)
    awake = np.where(u < 0.02, 0.0, u ** (1 / 4.5))
    phase = int(rng.integers(block))
    return np.repeat(IDLE_SHARE + (AWAKE_SHARE - IDLE_SHARE) * awake, block)[phase : phase + n_steps]


def as_trace(
    share: FloatArray,
    compute: FloatArray,
    name: str,
    provenance: Provenance,
    requests: RequestTimes | None = None,
) -> PowerTrace:
    """Trace of a (n,) share of rating on the grid; a closing sample lets the last step have its length.

    `compute`, (n,), is the part of the share that does work that follows the clock; it lies above the idle floor. Sums
    of shares may leave [IDLE_SHARE, 1] by rounding; they are put back.
    """
    share = np.clip(rounded(share), IDLE_SHARE, 1.0)
    compute = np.clip(rounded(compute), 0.0, share - IDLE_SHARE)
    time_s = np.arange(len(share) + 1, dtype=np.float64) * GRID_S
    return PowerTrace(
        time_s, np.append(share, share[-1]), name, provenance, np.append(compute, compute[-1]), requests, 1.0
    )


def rounded(share: FloatArray) -> FloatArray:
    """Shares to the nearest 2^-20, a millionth: the last bits of a platform's exponentials do not show."""
    return np.round(share * 2.0**20) * 2.0**-20
