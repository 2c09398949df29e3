"""Short-term flicker severity Pst of a series of RMS voltages.

IEC 61000-4-15 (edition 2, 2010) defines a meter of voltage waves in five blocks. The first two turn a wave into a
series of RMS voltages, so three remain. OpenDSS has the same meter for such series (a monitor of mode 4):

    block 3    high-pass of first order at 0.05 Hz, then the weighting of lamp, eye and brain
                   k w1 s / (s^2 + 2 lambda s + w1^2)  *  (1 + s/w2) / ((1 + s/w3) (1 + s/w4))
    block 4    square, low-pass of 0.3 s, and a scale at which the sinusoidal fluctuation of 8.8 Hz that is just seen
               (the standard's table 1) reaches 1: the instantaneous flicker sensation
    block 5    Pst = sqrt(0.0314 P0.1 + 0.0525 P1s + 0.0657 P3s + 0.28 P10s + 0.08 P50s) over 600 s, where P_x is the
               sensation exceeded x % of the time, and an s marks a mean of neighbours

The standard's low-pass of 35 or 42 Hz is omitted, because no such series contains these frequencies. A sample is
constant until the next, and the filters use the bilinear rule with several steps per sample. With one step of 0.1 s,
that rule shifts the filters' 8.8 Hz and misses the standard's test points by up to 19 %.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.checked import FieldError, finite, is_number

INTERVAL_S = 600.0
"""Interval of a Pst, s."""
LARGEST_DT_S = 0.1
"""Largest time between samples, s: six cycles of 60 Hz."""
_LARGEST_STEP_S = 0.01
_HIGH_PASS_HZ, _SMOOTHING_S, _SEEN_AT_HZ = 0.05, 0.3, 8.8


class Lamp(NamedTuple):
    """Incandescent lamp of 60 W and its observer, in the notation of the standard."""

    k: float
    lambda_hz: float
    """lambda / 2 pi, and so on."""
    w1_hz: float
    w2_hz: float
    w3_hz: float
    w4_hz: float
    seen_pct: float
    """Sinusoidal fluctuation of 8.8 Hz, peak to peak in % of the voltage, at which the sensation reaches 1."""


LAMPS = {
    "120V-60Hz": Lamp(1.6357, 4.167375, 9.077169, 2.939902, 1.394468, 17.31512, 0.321),
    "230V-50Hz": Lamp(1.74802, 4.05981, 9.15494, 2.27979, 1.22535, 21.9, 0.250),
}
"""The standard's two lamps."""

_GROUPS = (
    (0.0314, (0.1,)),
    (0.0525, (0.7, 1.0, 1.5)),
    (0.0657, (2.2, 3.0, 4.0)),
    (0.28, (6.0, 8.0, 10.0, 13.0, 17.0)),
    (0.08, (30.0, 50.0, 80.0)),
)
"""Weights of block 5, and the percentages of the time whose levels are averaged."""


def short_term_flicker(
    v_pu: np.ndarray, dt_s: float, lamp: str = "120V-60Hz", steps_per_sample: int | None = None
) -> np.ndarray:
    """Return Pst of each full interval of 600 s of RMS voltages; the filters are settled at the first sample.

    Parameters
    ----------
    v_pu
        RMS voltages, (n_sample, ..), as shares of the nominal voltage. The standard's meter uses the mean of the last
        minute instead; divide by that mean for the same result.
    dt_s
        Time from a sample to the next, s, at most 0.1.
    lamp
        The lamp: "120V-60Hz" or "230V-50Hz".
    steps_per_sample
        Steps of the filters per sample; by default enough for steps of at most 10 ms. The monitor of OpenDSS uses 1.

    Returns
    -------
    pst
        (n_interval, ..), one interval after another; samples after the last full interval are ignored.

    Raises
    ------
    ValueError
        For samples too far apart, a series too short, a voltage that is not finite, or an unknown lamp.
    """
    try:
        v_pu = np.asarray(v_pu, dtype=np.float64)
    except (TypeError, ValueError):
        raise _refused("v_pu", "is no array of numbers; give RMS voltages as shares of the nominal voltage") from None
    check_sampling(dt_s)
    n = len(v_pu) if v_pu.ndim else 0
    if n * dt_s < INTERVAL_S - 1e-6:
        raise _refused("v_pu", f"has {n} samples, {n * dt_s:g} s; a Pst takes at least {INTERVAL_S:g} s of them")
    if not np.isfinite(v_pu).all():
        raise _refused("v_pu", "has values that are not finite; give RMS voltages as shares of the nominal voltage")
    return severity(v_pu, dt_s, lamp, steps_per_sample)


def check_sampling(dt_s: float) -> None:
    """Raise ValueError unless samples ``dt_s`` apart, s, are close enough for flicker."""
    if not finite(dt_s, 1e-9, LARGEST_DT_S + 1e-9):
        raise FieldError("flicker", "dt_s", dt_s, f"give samples at most {LARGEST_DT_S:g} s apart, and more than 0 s")


def severity(v_pu: np.ndarray, dt_s: float, lamp: str = "120V-60Hz", steps_per_sample: int | None = None) -> np.ndarray:
    """Return Pst of each interval, see :func:`short_term_flicker`, without checks; a shorter series is one interval."""
    if not isinstance(lamp, str) or lamp not in LAMPS:
        raise FieldError("flicker", "lamp", lamp, f"choose one of {', '.join(LAMPS)}")
    steps = math.ceil(dt_s / _LARGEST_STEP_S - 1e-6) if steps_per_sample is None else steps_per_sample
    if not is_number(steps) or steps != int(steps) or steps < 1:
        raise FieldError("flicker", "steps_per_sample", steps, "give a whole number of at least 1")
    sections, scale, smoothing = _filters(lamp, dt_s / steps)
    per_interval = min(round(INTERVAL_S / dt_s), len(v_pu))
    intervals = len(v_pu) // per_interval
    used = v_pu[: intervals * per_interval].reshape(intervals * per_interval, -1)
    out = np.empty((intervals, used.shape[1]))
    for i in range(used.shape[1]):  # one series at a time: with ten steps a sample all at once would be large
        sensation = scale * _sensation(np.repeat(used[:, i] - used[0, i], int(steps)), sections, smoothing)
        out[:, i] = [_severity_of(part) for part in np.split(sensation, intervals)]
    return out.reshape(intervals, *v_pu.shape[1:])


class StreamingFlicker:
    """Streaming Pst of voltages, which stores at most one interval.

    Parameters
    ----------
    dt_s
        Time from a sample to the next, s, at most 0.1.
    lamp
        See :func:`short_term_flicker`.
    """

    def __init__(self, dt_s: float, lamp: str = "120V-60Hz"):
        check_sampling(dt_s)
        self._steps = math.ceil(dt_s / _LARGEST_STEP_S - 1e-6)
        self._filters = _filters(lamp, dt_s / self._steps)
        self._per_interval = round(INTERVAL_S / dt_s)
        self._parts: list[np.ndarray] = []
        self._first = np.empty(0)
        self._states: list[Any] = []
        self._largest: float | None = None

    def add(self, v_pu: np.ndarray) -> None:
        """Add further voltages, p.u., (n_sample, n_node)."""
        if not self._states:
            self._first, self._states = v_pu[0].copy(), [None] * v_pu.shape[1]
        self._parts.append(v_pu.copy())
        while sum(map(len, self._parts)) >= self._per_interval:
            waiting = np.concatenate(self._parts)
            self._parts = [waiting[self._per_interval :].copy()]
            self._take(waiting[: self._per_interval])

    def largest(self) -> float:
        """Return the largest Pst of a full interval and node so far; of the partial one if none is complete."""
        if self._largest is None:
            self._take(np.concatenate(self._parts))
            self._parts = [self._parts[0][:0]]
        return self._largest or 0.0

    def _take(self, v_pu: np.ndarray) -> None:
        sections, scale, smoothing = self._filters
        for i, (bus_v_pu, first) in enumerate(zip(v_pu.T, self._first, strict=True)):
            change = np.repeat(bus_v_pu - first, self._steps)
            sensation, self._states[i] = _sensation_from(self._states[i], change, sections, smoothing)
            self._largest = max(self._largest or 0.0, _severity_of(scale * sensation))


def _sensation_from(
    state: Any, change: np.ndarray, sections: np.ndarray, smoothing: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, Any]:
    """Return the result of ``_sensation`` for filters in a state (None: settled), and their new state."""
    from scipy import signal

    numerator, denominator = smoothing
    before, after = (np.zeros((len(sections), 2)), np.zeros(len(denominator) - 1)) if state is None else state
    filtered: Any = signal.sosfilt(sections, change, zi=before)
    weighted, before = filtered
    smoothed, after = signal.lfilter(numerator, denominator, weighted * weighted, zi=after)
    return smoothed, (before, after)


def _sensation(change: np.ndarray, sections: np.ndarray, smoothing: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Apply blocks 3 and 4 without the scale to a change from the settled state of the filters."""
    from scipy import signal  # slow to import, and not needed by a step

    weighted: Any = signal.sosfilt(sections, change)
    numerator, denominator = smoothing
    smoothed: Any = signal.lfilter(numerator, denominator, weighted * weighted)
    return smoothed


def _severity_of(sensation: np.ndarray) -> float:
    """Return Pst of the sensation in one interval (block 5)."""
    n = len(sensation)
    ranked = np.sort(np.maximum(sensation, 0.0))  # rounding may leave a tiny negative one
    pst_squared = 0.0
    for weight, exceeded_pct in _GROUPS:
        rank = np.minimum((1.0 - np.array(exceeded_pct) / 100.0) * n, n - 1.0)
        pst_squared += weight * np.interp(rank, np.arange(n), ranked).mean()
    return math.sqrt(pst_squared)


@cache
def _filters(lamp: str, step_s: float) -> tuple[np.ndarray, float, Any]:
    """Sections of block 3, the scale of block 4, and its low-pass, for steps of ``step_s``."""
    from scipy import signal

    lamp_filter = LAMPS[lamp]
    damping, w1, w2, w3, w4, high_pass, reference = (
        2.0 * np.pi * np.array([*lamp_filter[1:6], _HIGH_PASS_HZ, _SEEN_AT_HZ])
    )
    zeros = np.array([0.0, 0.0, -w2])
    poles = np.array([-high_pass, *np.roots([1.0, 2.0 * damping, w1 * w1]), -w3, -w4])
    gain = lamp_filter.k * w1 * w3 * w4 / w2
    response = gain * abs(np.prod(1j * reference - zeros) / np.prod(1j * reference - poles))
    amplitude = response * lamp_filter.seen_pct / 200.0
    # What the low-pass leaves of the square's other half.
    ripple = 1.0 / math.hypot(1.0, 2.0 * reference * _SMOOTHING_S)
    sections = signal.zpk2sos(*signal.bilinear_zpk(zeros, poles, gain, 1.0 / step_s))
    smoothing = signal.bilinear([1.0], [_SMOOTHING_S, 1.0], 1.0 / step_s)
    return sections, 2.0 / (amplitude * amplitude * (1.0 + ripple)), smoothing


def _refused(name: str, remedy: str) -> FieldError:
    return FieldError("flicker", name, ..., remedy)
