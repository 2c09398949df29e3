"""What a recording contains, and what an environment does with it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dcgrid_env.traces.checks import FloatArray, TraceError, require_positive, steps_in
from dcgrid_env.traces.recorded_rows import from_recordings
from dcgrid_env.traces.rows import SPLITS
from dcgrid_env.traces.sampling import GAP_INTERVALS
from dcgrid_env.traces.trace import PowerTrace

CONSTANT_S = 60.0
CONSTANT_SAMPLES = 20
"""Power of one value is reported if it lasts at least this long and for at least so many samples."""
IDLE_QUANTILE = 0.05
"""Share of the time in which the power is at most the idle level."""
USUAL_QUANTILE = 0.995
PEAK_TIMES = 2.0
"""An unknown rating is doubtful if the peak is this many times the power that is exceeded only for the rest of
USUAL_QUANTILE of the time."""
SLOWER = 1.1
"""Samples that are this many steps apart miss ramps; loggers wait their interval after each sample, so it is longer."""
COUNTER_SAMPLES = 20
"""Samples from which on a power that never falls is reported."""
RAMP_QUANTILES = (0.5, 0.95, 0.99, 1.0)


@dataclass(frozen=True)
class Stretch:
    """A stretch of time."""

    begin_s: float
    """Begin, s from the first sample."""
    duration_s: float
    level_kw: float
    """Power in it, kW."""


@dataclass(frozen=True)
class RecordingReport:
    """Findings on a recording; see `check_recording`."""

    name: str
    duration_s: float
    samples: int
    meters: int
    """Meters that were summed."""
    interval_s: float
    """Usual interval between samples of a meter, the median, s."""
    jitter_s: float
    """Deviation from the usual interval that 95 % of the intervals outside gaps do not exceed, s."""
    gaps: int
    longest_gap_s: float
    gap_share: float
    """Share of the duration that is in gaps."""
    gap_meter: str
    """Meter with the most time in gaps; "" if there is one meter or no gap."""
    constant: tuple[Stretch, ...]
    """Long stretches of one value, the longest first."""
    zero_share: float
    """Share of the time at 0 kW."""
    below_idle_share: float
    """Share of the time below the idle power of the site, whose rating is `full_kw`."""
    rated_kw: float | None
    """Known rating, kW; None if it is unknown."""
    is_share: bool
    """Whether the power is in shares of a rating, which is then 1 kW."""
    idle_kw: float
    peak_kw: float
    usual_peak_kw: float
    """Power that is not exceeded for USUAL_QUANTILE of the time, kW."""
    mean_kw: float
    never_falls: bool
    """Whether the power rises in most intervals and never falls, as a counter of energy does."""
    ramps_kw: tuple[float, ...]
    """Absolute changes of the mean over a step from one step to the next, at RAMP_QUANTILES, kW."""
    dt_s: float
    """Step of the environment, s."""
    needed_s: float
    """Duration of a window, an episode and the step after it, s."""
    windows: dict[str, int]
    """Disjoint windows by split; 0 if the split is too short for one."""

    @property
    def full_kw(self) -> float:
        """The power that shares refer to: the rating, or the peak if it is unknown, kW."""
        return self.peak_kw if self.rated_kw is None else self.rated_kw

    @property
    def idle_share(self) -> float:
        """Idle power as a share of `full_kw`."""
        return self.idle_kw / self.full_kw

    @property
    def peak_share(self) -> float:
        """Peak as a share of `full_kw`."""
        return self.peak_kw / self.full_kw

    def record(self) -> dict[str, Any]:
        """Return the findings as JSON values."""
        ramps = {f"{quantile:g}": kw for quantile, kw in zip(RAMP_QUANTILES, self.ramps_kw, strict=True)}
        return asdict(self) | {
            "ramps_kw": ramps,
            "full_kw": self.full_kw,
            "idle_share": self.idle_share,
            "peak_share": self.peak_share,
        }

    def lines(self) -> list[str]:
        """Return the findings as text, a line each."""
        reference = "peak, as the rating is unknown" if self.rated_kw is None else "rating"
        gaps = "none"
        if self.gaps:
            gaps = f"{self.gaps}, the longest {self.longest_gap_s:g} s, {self.gap_share:.2%} of the time"
            gaps += f" ({self.gap_meter})" if self.gap_meter else ""
        stretches = ", ".join(
            f"{self._level(s.level_kw)} for {s.duration_s:g} s from {s.begin_s:g} s" for s in self.constant
        )
        ramps = ", ".join(
            f"{'largest' if quantile == 1.0 else f'{quantile:.0%}'} {self._level(kw)}"
            for quantile, kw in zip(RAMP_QUANTILES, self.ramps_kw, strict=True)
        )
        rating = "unknown" if self.rated_kw is None else f"{self.rated_kw:g} kW"
        each = f" of each of {self.meters} meters" if self.meters > 1 else ""
        levels = (("idle", self.idle_kw), ("mean", self.mean_kw), ("peak", self.peak_kw))
        return [
            f"duration: {self.duration_s:g} s, {self.samples} samples",
            f"sampling: every {self.interval_s:.4g} s{each}, jitter {self.jitter_s:.3f} s (95 %)",
            f"gaps of more than {GAP_INTERVALS:g} intervals: {gaps}; a sample holds until the next",
            f"constant: {stretches or 'no long stretch'}; no power for {self.zero_share:.1%} of the time",
            f"rating: {'power is in shares of it' if self.is_share else rating}",
            f"power: {', '.join(f'{name} {self._level(kw)}' for name, kw in levels)}; shares of the {reference}",
            f"ramps over {self.dt_s:g} s: {ramps}",
            f"independent windows of {self.needed_s:g} s: "
            + ", ".join(f"{split} {count}" for split, count in self.windows.items()),
        ]

    def _level(self, kw: float) -> str:
        """Return a power as text, with its share of `full_kw`."""
        share = f"{kw / self.full_kw:.1%}"
        return share if self.is_share else f"{kw:.4g} kW ({share})"

    def warnings(self) -> list[str]:
        """Return findings that a user should act on, a line each."""
        texts = []
        if short := [split for split, count in self.windows.items() if count == 0]:
            texts.append(
                f"the splits {', '.join(short)} are too short for an episode of {self.needed_s:g} s; record at least "
                f"{self.needed_s / 0.2:.0f} s, or shorten the episode (--horizon); run, check, capacity and study use "
                "all of a recording and repeat a short one"
            )
        elif few := [split for split, count in self.windows.items() if count < 5]:
            texts.append(
                f"few independent windows in {', '.join(few)}; results there depend on a few stretches of time"
            )
        if self.interval_s > self.dt_s * SLOWER:
            texts.append(
                f"samples are {self.interval_s:g} s apart, the environment's step is {self.dt_s:g} s; ramps faster "
                "than the sampling are missing, and each change falls into one step"
            )
        if self.gap_share > 0.01:
            texts.append(f"{self.gap_share:.1%} of the time is in gaps, in which the power is constant")
        if self.is_share:
            texts.append("the power is in shares of a rating; pass --rated-kw to have it in kW")
        elif self.rated_kw is None:
            texts.append("the rating is unknown, so the peak stands for it; pass --rated-kw if the site can draw more")
            if self.peak_kw > PEAK_TIMES * self.usual_peak_kw:
                texts.append(
                    f"the peak of {self.peak_kw:.4g} kW stands for the rating, but the power exceeds "
                    f"{self.usual_peak_kw:.4g} kW for {1 - USUAL_QUANTILE:.1%} of the time only; check that it is no "
                    "error of the meter, or pass --rated-kw"
                )
        elif self.peak_kw > self.rated_kw * (1 + 1e-9):
            texts.append(
                f"the peak of {self.peak_kw:g} kW exceeds the rating of {self.rated_kw:g} kW; correct --rated-kw"
            )
        if self.never_falls:
            texts.append(
                "the power rises all the time and never falls, as a counter of energy does; check that the file "
                "contains power"
            )
        if self.below_idle_share > 0.01:
            texts.append(
                f"{self.below_idle_share:.1%} of the time is below the site's idle power, which no clock reduces; see "
                "datacenters.idle_share"
            )
        if self.zero_share > 0:
            texts.append("the power is 0 at times; check for an outage of the meter, or cut the file there")
        return texts


def check_recording(trace: PowerTrace, dt_s: float, needed_s: float, site_idle_share: float) -> RecordingReport:
    """Describe a recording and count the windows that an environment can draw from it.

    Parameters
    ----------
    trace : a recording of at least two steps.
    dt_s : step of the environment, s.
    needed_s : duration of a window, s.
    site_idle_share : idle power of the site as a share of its rating.

    Returns
    -------
    RecordingReport

    Raises
    ------
    TraceError
        If the recording is shorter than two steps or draws no power.
    """
    dt_s = require_positive(dt_s, "dt_s", "give a step in seconds")
    needed_s = require_positive(needed_s, "needed_s", "give the duration of an episode in seconds")
    trace.require_duration(2 * dt_s)
    time_s, power_kw = trace.time_s - trace.time_s[0], trace.power_kw
    if not power_kw.max() > 0:
        raise TraceError(f"trace {trace.name!r}: draws no power in {len(power_kw)} samples; check the power columns")
    interval_s, sampling = np.diff(time_s), trace.sampling
    steps_kw = trace.resample(dt_s)
    full_kw = float(power_kw.max()) if trace.rated_kw is None else trace.rated_kw
    return RecordingReport(
        name=trace.name,
        duration_s=trace.duration_s,
        samples=len(time_s),
        meters=sampling.meters,
        interval_s=sampling.interval_s,
        jitter_s=sampling.jitter_s,
        gaps=sampling.gaps,
        longest_gap_s=sampling.longest_gap_s,
        gap_share=min(1.0, sampling.gap_s / trace.duration_s),
        gap_meter=sampling.meter,
        constant=_constant(time_s, power_kw),
        zero_share=float(interval_s[power_kw[:-1] == 0.0].sum() / trace.duration_s),
        below_idle_share=float(interval_s[power_kw[:-1] < site_idle_share * full_kw].sum() / trace.duration_s),
        rated_kw=trace.rated_kw,
        is_share=trace.is_share,
        idle_kw=_level_kw(interval_s, power_kw[:-1], IDLE_QUANTILE),
        peak_kw=float(power_kw.max()),
        usual_peak_kw=_level_kw(interval_s, power_kw[:-1], USUAL_QUANTILE),
        never_falls=_never_falls(power_kw),
        mean_kw=trace.energy_kws / trace.duration_s,
        ramps_kw=tuple(np.quantile(np.abs(np.diff(steps_kw)), RAMP_QUANTILES).tolist()),
        dt_s=dt_s,
        needed_s=needed_s,
        windows={split: _windows(trace, split, dt_s, needed_s) for split in SPLITS},
    )


def _constant(time_s: FloatArray, power_kw: FloatArray, most: int = 3) -> tuple[Stretch, ...]:
    """Return the longest stretches of one value, the longest first."""
    begins = np.concatenate([[0], np.flatnonzero(np.diff(power_kw[:-1])) + 1])
    ends = np.append(begins[1:], len(power_kw) - 1)
    duration_s = time_s[ends] - time_s[begins]
    is_long = (duration_s >= CONSTANT_S) & (ends - begins >= CONSTANT_SAMPLES)
    longest = sorted(np.flatnonzero(is_long).tolist(), key=lambda i: -duration_s[i])[:most]
    return tuple(Stretch(float(time_s[begins[i]]), float(duration_s[i]), float(power_kw[begins[i]])) for i in longest)


def _never_falls(power_kw: FloatArray) -> bool:
    """Return whether the power rises in most intervals and falls in none."""
    rises = np.diff(power_kw)
    return len(power_kw) >= COUNTER_SAMPLES and bool((rises >= 0).all() and np.mean(rises > 0) > 0.5)


def _level_kw(interval_s: FloatArray, power_kw: FloatArray, quantile: float) -> float:
    """Return the power that is not exceeded for a share of the time, kW."""
    order = np.argsort(power_kw)
    held_s = np.cumsum(interval_s[order])
    return float(power_kw[order[int(np.searchsorted(held_s, quantile * held_s[-1]))]])


def _windows(trace: PowerTrace, split: str, dt_s: float, needed_s: float) -> int:
    """Return the number of disjoint windows in a split."""
    try:
        # The rating does not change the number, and a peak above it is reported elsewhere.
        rows = from_recordings([trace.rated_at(max(trace.rated_kw or 0.0, float(trace.power_kw.max())))], split, dt_s)
    except TraceError:
        return 0
    return rows.p_share.shape[-1] // max(1, -steps_in(-needed_s, dt_s))
