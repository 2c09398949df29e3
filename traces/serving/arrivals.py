"""Arrival laws of requests: Poisson, gamma and two-state laws, each a special case of the next, and a daily cycle.

The rate lambda(t) switches between a calm and a busy value, after exponential times unless they are said to be more
regular, and follows the hour of the day.
Requests come by a renewal process in operational time, the integral of lambda, with gamma-distributed distances of mean
1 (shape 1 is Poisson):

    Lambda(t) = integral of lambda        Lambda(t_i) = sum of i gamma draws
    lambda_busy = rate (calm_s + busy_s) / (calm_rate calm_s + busy_s)        lambda_calm = calm_rate lambda_busy

A two-state Poisson process is a switched Poisson process [1]. The Fano factor of its counts over w seconds tends, for
long w, to 1 + 2 var(lambda) tau / rate with 1 / tau = 1 / calm_s + 1 / busy_s.

[1] W. Fischer and K. Meier-Hellstern, "The Markov-modulated Poisson process cookbook", Performance Evaluation 18, 1993.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dcgrid_env.traces.checks import FloatArray, TraceError, require_positive

DAY_S = 86400.0
# The hour of the day is followed in pieces of this length, s.
_CYCLE_STEP_S = 60.0
# Requests drawn at once: part of the law, because sums are rounded piece by piece.
_BATCH = 65536


@dataclass(frozen=True)
class Arrivals:
    """A law of arrival; by default Poisson. Fields out of range raise TraceError."""

    rate_per_s: float
    """Long-run mean rate, 1/s."""
    shape: float = 1.0
    """Shape of the gamma distances in operational time; 1 is Poisson, less is clustered."""
    calm_rate: float = 1.0
    """Rate of the calm state as a share of the busy one's; 1: one state only."""
    calm_s: float = 1.0
    """Mean time in the calm state, s."""
    busy_s: float = 1.0
    """Mean time in the busy state, s."""
    dwell_shape: float = 1.0
    """Shape of the gamma law of the times in both states: 1 is exponential, much more gives waves of an even length."""
    daily_swing: float = 0.0
    """The rate rises and falls by this share over the day; 0: no daily cycle."""
    peak_hour: float = 15.0

    def __post_init__(self) -> None:
        for name in ("rate_per_s", "shape", "calm_s", "busy_s", "dwell_shape"):
            require_positive(getattr(self, name), f"Arrivals.{name}", "give a value above 0")
        for name, high in (("calm_rate", 1.0), ("daily_swing", 1.0), ("peak_hour", 24.0)):
            value = getattr(self, name)
            if not (math.isfinite(value) and 0 <= value <= high):
                raise TraceError(f"Arrivals.{name} = {value!r} is not in 0 to {high:g}")

    def draw(self, rng: np.random.Generator, duration_s: float, begin_s: float = 0.0) -> Iterator[FloatArray]:
        """Yield the arrivals in [0, duration_s) in order, s, (n,) float64 each, to the microsecond.

        `begin_s` is the time of day at which they begin, s after midnight.
        """
        time_s, operational = self._operational_time(rng, duration_s, begin_s)
        reached = 0.0
        while True:
            marks = reached + np.cumsum(rng.gamma(self.shape, 1.0 / self.shape, _BATCH))
            reached = float(marks[-1])
            arrival_s = np.interp(marks[marks < operational[-1]], operational, time_s)
            yield np.floor(arrival_s * 1e6) * 1e-6
            if reached >= operational[-1]:
                return

    def _operational_time(self, rng: np.random.Generator, duration_s: float, begin_s: float):
        """Times (n,), s, from 0 to `duration_s` and the integral of the rate up to each."""
        busy_rate = self.rate_per_s * (self.calm_s + self.busy_s) / (self.calm_rate * self.calm_s + self.busy_s)
        edges, rates = np.zeros(1), np.full(1, self.rate_per_s)
        if self.calm_rate < 1.0:
            busy_first = rng.random() < self.busy_s / (self.calm_s + self.busy_s)
            means = (self.busy_s, self.calm_s) if busy_first else (self.calm_s, self.busy_s)
            pairs = 16 + math.ceil(duration_s / (self.calm_s + self.busy_s))
            while edges[-1] < duration_s:
                draws = [rng.gamma(self.dwell_shape, mean / self.dwell_shape, pairs) for mean in means]
                lengths = np.column_stack(draws).ravel()
                if self.dwell_shape != 1.0 and len(edges) == 1:
                    lengths[0] *= rng.random()  # begun before, which exponential times forget
                edges = np.concatenate((edges, edges[-1] + np.cumsum(lengths)))
            levels = (1.0, self.calm_rate) if busy_first else (self.calm_rate, 1.0)
            rates = busy_rate * np.resize(levels, len(edges))
        ends = np.arange(_CYCLE_STEP_S, duration_s, _CYCLE_STEP_S) if self.daily_swing else np.zeros(0)
        time_s = np.unique(np.concatenate((edges[edges < duration_s], ends, [duration_s])))
        rate = rates[np.searchsorted(edges, time_s[:-1], side="right") - 1]
        if self.daily_swing:
            hour = ((begin_s + 0.5 * (time_s[:-1] + time_s[1:])) % DAY_S) / 3600.0
            rate = rate * (1.0 + self.daily_swing * np.cos(2.0 * np.pi * (hour - self.peak_hour) / 24.0))
        return time_s, np.concatenate(([0.0], np.cumsum(rate * np.diff(time_s))))
