"""Search for the largest feasible size at one bus: choose the next size to try, and the samples to try it in.

Sizes are whole numbers of steps. A size is feasible if it breaks limits in no more seconds than are allowed, over all
samples. It is infeasible as soon as it breaks them in more seconds of some samples. Between the largest feasible size
and the smallest infeasible one, sizes are therefore tried only in the *critical* samples, those that came nearest to a
limit before. The largest size that remains is then tried in the other samples.

The next size is where the first straight line between the margins at both ends crosses zero. This is the regula falsi
in its Illinois form, in which an end that stays counts half (M. Dowell and P. Jarratt, BIT 11, 1971). Every fourth try
is a bisection, so that a margin with a kink cannot slow the search down. Under a controller a larger size may be
feasible although a smaller one is not. At the end one size of a coarse scan below the result and one above it are
therefore tried too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env.apps.hosting.trial import UNLIMITED, Trial

CRITICAL = 6
"""Number of critical samples for each limit, those nearest to it."""


class Request(NamedTuple):
    """A size to try, and the samples to try it in."""

    size: int
    samples: np.ndarray
    """Numbers of the samples, (n,)."""


class BusSearch:
    """The search at one bus; ``next`` returns the next request, and ``take`` receives its result.

    Parameters
    ----------
    empty
        Result of size 0 in all samples; this size is feasible.
    critical
        Numbers of the initial critical samples.
    guess, top
        The size to try first, and the largest.
    allowed
        Allowed number of steps with broken limits, over all samples.
    scan
        Sizes in ascending order. At the end the nearest below the result and the nearest above it are tried.
    """

    def __init__(
        self, empty: Trial, critical: np.ndarray, guess: int, top: int, allowed: int, scan: tuple[int, ...] = ()
    ):
        self._every = np.arange(len(empty.outside))
        self._top, self._allowed = top, allowed
        self._guess: int | None = min(max(guess, 1), top)
        self._low, self._high = 0, top + 1
        self._at_low, self._at_high = empty.margins.min(axis=0), None
        self._moved = 0
        """End that moved last, -1 for the lower one, 1 for the upper one."""
        self._tries = 0
        self.size = 0
        """Largest size that was found feasible in all samples."""
        self.at_size = empty
        """Result of this size, in the order of the samples."""
        self.beyond: Trial | None = None
        """Result of the smallest infeasible size, in the samples in which it was tried; None if all are feasible."""
        self.limiting: int | None = None
        """The sample that comes nearest to a limit at that size; None if all are feasible."""
        self.smaller_fails: tuple[int, ...] = ()
        """Infeasible sizes of the scan below the result."""
        self.larger_carries: tuple[int, ...] = ()
        """Feasible sizes of the scan above the result."""
        self._empty = empty
        self._critical = np.unique(critical)
        self._at_low_trial: tuple[Request, Trial] | None = None
        """Result of the largest possibly feasible size in the critical samples."""
        self._scan, self._whole_scan = scan, False
        self._to_scan: list[int] | None = None

    def next(self) -> Request | None:
        """Return the next request; None when the search is complete."""
        if self._guess is not None:
            return Request(self._guess, self._critical)
        if self._high - self._low > 1:
            return Request(self._between(), self._critical)
        if self._low > self.size:
            assert self._at_low_trial is not None
            return Request(self._low, np.setdiff1d(self._every, self._at_low_trial[0].samples))
        if self._to_scan is None:
            below = [size for size in self._scan if 0 < size < self.size]
            above = [size for size in self._scan if self._high < size <= self._top]
            self._to_scan = below[-1:] + above[:1]
        if self._to_scan:
            return Request(self._to_scan[0], self._every if self._whole_scan else self._critical)
        return None

    def take(self, request: Request, trial: Trial) -> None:
        """Update the search with the result of a request."""
        if self._to_scan is not None:
            fails = int(trial.outside.sum()) > self._allowed
            self._take_scanned(request.size, fails, len(request.samples) == len(self._every))
            return
        before = self._at_low_trial
        if before is not None and request.size == before[0].size:  # the others of its samples
            samples = np.concatenate((before[0].samples, request.samples))
            order = np.argsort(samples)
            request, trial = Request(request.size, samples[order]), Trial.joined([before[1], trial]).select(order)
        fails, whole = int(trial.outside.sum()) > self._allowed, len(request.samples) == len(self._every)
        self._guess, self._tries = None, self._tries + 1
        margins = trial.margins.min(axis=0)
        if fails:
            self.beyond = trial
            self.limiting = int(request.samples[trial.margins.min(axis=1).argmin()])
            if self._low >= request.size:  # feasible in the critical samples, but not in all
                self._low, self._at_low = self.size, self.at_size.margins.min(axis=0)
                self._at_low_trial = None
            elif self._moved == 1:
                self._at_low = 0.5 * self._at_low
            self._high, self._at_high, self._moved = request.size, margins, 1
        else:
            if self._moved == -1 and self._at_high is not None:
                self._at_high = 0.5 * self._at_high
            self._low, self._at_low, self._moved = request.size, margins, -1
            self._at_low_trial = (request, trial)
            if whole:
                self.size, self.at_size = request.size, trial
        if whole:
            worst = request.samples[worst_samples(trial)]
            self._critical = np.union1d(self._critical, worst) if fails else worst

    def _take_scanned(self, size: int, fails: bool, whole: bool) -> None:
        assert self._to_scan is not None
        if not fails and not whole and size > self.size:
            self._whole_scan = True  # all samples decide
            return
        self._to_scan, self._whole_scan = self._to_scan[1:], False
        if fails and size < self.size:
            self.smaller_fails += (size,)
        if not fails and size > self.size:
            self.larger_carries += (size,)

    def _between(self) -> int:
        """Choose a size between the largest possibly feasible one and the smallest infeasible one, or beyond."""
        low, high = self._low, self._high
        if self._at_high is None:  # none has failed: as far as the margins' fall since size 0 lets expect, and a little
            fall = (self._empty.margins.min(axis=0) - self._at_low) / max(low, 1)
            reach = min(2.0 * low, float(_lengths(self._at_low, fall).min()))
            return min(max(low + 1 + int(1.05 * reach), low + 1), self._top)
        if self._allowed or self._tries % 4 == 3:
            return (low + high) // 2
        share = float(_lengths(self._at_low, self._at_low - self._at_high).min())
        return min(max(low + int((high - low) * share), low + 1), high - 1) if share < 1.0 else (low + high) // 2


def worst_samples(trial: Trial) -> np.ndarray:
    """Return the positions of the samples that came nearest to each limit in a trial at one bus, (n,)."""
    order = np.argsort(trial.margins, axis=0, kind="stable")[:CRITICAL]
    return np.unique(order[:, (trial.margins < UNLIMITED).any(axis=0)])


def _lengths(margins: np.ndarray, falls: np.ndarray) -> np.ndarray:
    """Compute the length over which each margin is used up, given its fall per unit; infinite if it does not fall."""
    falling = falls > 1e-12
    return np.where(falling, np.maximum(margins, 0.0) / np.where(falling, falls, 1.0), np.inf)
