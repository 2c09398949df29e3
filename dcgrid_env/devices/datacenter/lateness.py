"""Lateness of work with a deadline, from the work that arrived and was served in each step.

Work that arrives in step k and is served in step m has waited m - k steps, one more if it was moved. It is late by the
part of this wait that exceeds its slack. Work that is not served by the end counts as served one step after the last.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np


def lateness(
    arrived_kw: np.ndarray,
    moved_kw: np.ndarray,
    served_kw: np.ndarray,
    slack: tuple[int, int],
    interactive_share: float,
    by_deadline: bool,
    dt_s: float,
) -> dict[str, float]:
    """Figures over all work of all sites, 100 % in time and 0 s late where none arrived.

    Parameters
    ----------
    arrived_kw, moved_kw, served_kw
        Work that arrived in each step, the part of it that was moved, and work served, (n_step, n_site), kW.
    slack
        Steps beyond its own in which interactive and in which deferrable work is in time.
    interactive_share, by_deadline
        See ``ServiceLevels``.
    dt_s
        Length of a step, s.
    """
    no_work: list[tuple[list[np.ndarray], list[np.ndarray]]] = [([np.zeros(0)] * 2, [np.zeros(0)] * 2)]
    of_sites = no_work + [
        _of_site((arrived - moved, moved), served, slack, interactive_share, by_deadline)
        for arrived, moved, served in zip(arrived_kw.T, moved_kw.T, served_kw.T, strict=True)
    ]
    by_kind = [tuple(np.concatenate([site[part][kind] for site in of_sites]) for part in (0, 1)) for kind in (0, 1)]
    return late_figures(by_kind, dt_s)


def late_figures(by_kind: Sequence[tuple[np.ndarray, ...]], dt_s: float) -> dict[str, float]:
    """Figures from steps late and work, (n,) each, of interactive and of deferrable work."""
    steps, weight = (np.concatenate(both) for both in zip(*by_kind, strict=True))
    mean, p95 = _mean_and_p95(steps, weight)
    return {
        "in_time_pct": _in_time(steps, weight),
        "interactive_in_time_pct": _in_time(*by_kind[0]),
        "deferrable_in_time_pct": _in_time(*by_kind[1]),
        "lateness_mean_s": mean * dt_s,
        "lateness_p95_s": p95 * dt_s,
    }


def _of_site(
    parts: tuple[np.ndarray, np.ndarray],
    served: np.ndarray,
    slack: tuple[int, int],
    share: float,
    by_deadline: bool,
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Steps late and work, of what was served together or never, for interactive and for deferrable work."""
    line = line_up(parts, slack, share, by_deadline)
    rounding = 1e-9 * line.amount.sum()
    late: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
    work: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])

    def note(step: int, taken: np.ndarray) -> None:
        for kind, (steps_late, taken_kws) in enumerate(line.lateness(step, taken)):
            late[kind].append(steps_late)
            work[kind].append(taken_kws)

    left = serve_in_line(line, served, 0, rounding, note)
    left[left <= rounding] = 0.0
    note(len(served), left)
    return [np.concatenate(x) for x in late], [np.concatenate(x) for x in work]


def serve_in_line(
    line: Line, served: np.ndarray, first: int, rounding: float, note: Callable[[int, np.ndarray], None]
) -> np.ndarray:
    """Serve a queue over some steps, starting with ``first``, and return the remaining amount of each entry.

    ``note`` is called with each step and the amount taken from each entry.
    """
    left = line.amount.copy()
    for step, capacity in enumerate(served, first):
        present = np.where(line.came <= step, left, 0.0)
        before = np.cumsum(present) - present
        taken = np.clip(capacity + rounding - before, 0.0, present)
        left = left - taken
        note(step, taken)
    return left


class Line(NamedTuple):
    """Arrived work in the order of service, (n,) or by kind of work, interactive first, (2, n)."""

    amount: np.ndarray
    came: np.ndarray
    """Step of its arrival."""
    of_kind: np.ndarray
    """Share of it that is of either kind."""
    due: np.ndarray
    """Last step in which it is in time."""
    place: np.ndarray
    """Priority in the queue: the lower, the earlier it is served."""
    group: np.ndarray
    """What comes first of those with the same place, and then the earlier arrival."""

    def in_order(self) -> Line:
        """Those in line, in the order in which they are served."""
        order = np.lexsort((self.came, self.group, self.place))
        return Line(*(column[..., order] for column in self))

    def lateness(self, step: int, taken: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Steps late and work, by kind, of what a step takes."""
        there = taken > 0.0
        return [
            (np.maximum(step - self.due[kind, there], 0).astype(np.float64), self.of_kind[kind, there] * taken[there])
            for kind in (0, 1)
        ]


def line_up(
    parts: tuple[np.ndarray, np.ndarray], slack: tuple[int, int], share: float, by_deadline: bool, first: int = 0
) -> Line:
    """Queue all work: each kind separately for earliest deadline first, otherwise both mixed as they arrive.

    ``parts`` contains the work kept and the work moved in each step, (n_step,); the first step is ``first``.
    """
    steps, shares = first + np.arange(len(parts[0])), (share, 1.0 - share)
    amounts, places, came, of_kind, due, groups = [], [], [], [], [], []
    for less, part in enumerate(parts):  # what was kept, and what was moved
        last = np.stack([steps + max(its - less, 0) for its in slack])
        mixed = [(part, steps - less, np.array(shares))]
        apart = [(shares[kind] * part, last[kind], np.eye(2)[kind]) for kind in (0, 1)]
        for amount, place, kinds in apart if by_deadline else mixed:
            amounts.append(amount)
            places.append(place)
            came.append(steps)
            groups.append(np.full(len(steps), len(groups)))
            of_kind.append(np.tile(kinds[:, None], len(steps)))
            due.append(last)
    return Line(*map(np.hstack, (amounts, came, of_kind, due, places, groups))).in_order()


def _in_time(steps: np.ndarray, weight: np.ndarray) -> float:
    whole = weight.sum()
    return 100.0 * float(weight[steps <= 0.0].sum() / whole) if whole > 0.0 else 100.0


def _mean_and_p95(steps: np.ndarray, weight: np.ndarray) -> tuple[float, float]:
    whole = weight.sum()
    if whole <= 0.0:
        return 0.0, 0.0
    order = np.argsort(steps, kind="stable")
    share = np.cumsum(weight[order]) / whole
    position = min(int(np.searchsorted(share, 0.95 - 1e-12)), len(share) - 1)
    return float((steps * weight).sum() / whole), float(steps[order][position])
