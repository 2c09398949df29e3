"""How late work was served that had a time to be served by, from what arrived and was served in each step.

Work that arrives in step k and is served in step m has waited m - k steps, one more if it was moved, and is late by
what that is beyond its slack. Work that is not served by the end counts as if it were in the step after the last.
"""

from __future__ import annotations

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
    none: list[tuple[list[np.ndarray], list[np.ndarray]]] = [([np.zeros(0)] * 2, [np.zeros(0)] * 2)]
    of_sites = none + [
        _of_site((arrived - moved, moved), served, slack, interactive_share, by_deadline)
        for arrived, moved, served in zip(arrived_kw.T, moved_kw.T, served_kw.T, strict=True)
    ]
    by_kind = [tuple(np.concatenate([of[what][kind] for of in of_sites]) for what in (0, 1)) for kind in (0, 1)]
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
    shares = (share, 1.0 - share)
    # Each entry: work of a kind, what is due when, and its place in line.
    amounts, due, place = [], [], []
    steps = np.arange(len(served))
    for kind in (0, 1):
        for less, part in enumerate(parts):
            last = steps + max(slack[kind] - less, 0)
            amounts.append(shares[kind] * part)
            due.append(last)
            place.append(last if by_deadline else steps - less)
    kinds = np.repeat([0, 0, 1, 1], len(served))
    amount, when, order = np.concatenate(amounts), np.concatenate(due), np.concatenate(place)
    came = np.tile(steps, 4)
    in_line = np.argsort(order, kind="stable")
    amount, when, came, kinds = amount[in_line], when[in_line], came[in_line], kinds[in_line]
    rounding = 1e-9 * amount.sum()
    late: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
    work: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])

    def note(step: int, taken: np.ndarray) -> None:
        for kind in (0, 1):
            there = (kinds == kind) & (taken > 0.0)
            late[kind].append(np.maximum(step - when[there], 0).astype(np.float64))
            work[kind].append(taken[there])

    left = amount.copy()
    for step, capacity in enumerate(served):
        here = np.where(came <= step, left, 0.0)
        before = np.cumsum(here) - here
        taken = np.clip(capacity + rounding - before, 0.0, here)
        left = left - taken
        note(step, taken)
    left[left <= rounding] = 0.0
    note(len(served), left)
    return [np.concatenate(x) for x in late], [np.concatenate(x) for x in work]


def _in_time(steps: np.ndarray, weight: np.ndarray) -> float:
    whole = weight.sum()
    return 100.0 * float(weight[steps <= 0.0].sum() / whole) if whole > 0.0 else 100.0


def _mean_and_p95(steps: np.ndarray, weight: np.ndarray) -> tuple[float, float]:
    whole = weight.sum()
    if whole <= 0.0:
        return 0.0, 0.0
    order = np.argsort(steps, kind="stable")
    share = np.cumsum(weight[order]) / whole
    at = min(int(np.searchsorted(share, 0.95 - 1e-12)), len(share) - 1)
    return float((steps * weight).sum() / whole), float(steps[order][at])
