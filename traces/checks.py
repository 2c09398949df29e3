"""Checks of trace samples and of numbers from a caller, and their error."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class TraceError(ValueError):
    """A trace, or a request for one, that cannot be used; the message names the value and the remedy."""


def require_positive(value: float, field: str, remedy: str) -> float:
    """Return `value` as a float; raise TraceError unless it is finite and above zero."""
    number = float(value)
    if not (math.isfinite(number) and number > 0):
        raise TraceError(f"{field} = {value!r} is not a finite number above 0; {remedy}")
    return number


def steps_in(duration_s: float, dt_s: float) -> int:
    """Whole steps of dt_s in duration_s; a rounding error of 1e-9 of a step does not cost a step."""
    return math.floor(duration_s / dt_s + 1e-9)


def check_samples(time_s: FloatArray, power: FloatArray, where, time_field: str, power_fields: Sequence[str]) -> None:
    """Raise TraceError at the first sample that is not finite, negative, or out of order.

    Parameters
    ----------
    time_s : (n,) float64.
    power : (n,) or (n, n_column) float64.
    where : index -> text that begins the message, for example "file.csv, line 7".
    time_field, power_fields : names of the columns in messages.
    """
    table = power.reshape(len(power), -1)
    for values, field in [(time_s, time_field), *((table[:, j], f) for j, f in enumerate(power_fields))]:
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise TraceError(f"{where(bad[0])}: {field} is {values[bad[0]]}; remove or repair the sample")
    for j, field in enumerate(power_fields):
        bad = np.flatnonzero(table[:, j] < 0)
        if bad.size:
            raise TraceError(
                f"{where(bad[0])}: {field} is {table[bad[0], j]:g}; power is consumption and not negative: "
                "check the sign, the unit and the column"
            )
    bad = np.flatnonzero(np.diff(time_s) <= 0)
    if bad.size:
        i = int(bad[0]) + 1
        fault = "repeats" if time_s[i] == time_s[i - 1] else "comes after"
        raise TraceError(
            f"{where(i)}: {time_field} {time_s[i]!s} {fault} {time_s[i - 1]!s}; sort the samples by time, one at each"
        )
