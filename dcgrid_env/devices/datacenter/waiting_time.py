"""Waiting times of queued work, first come first served.

Work that arrives in step k and is served in step m has waited (m - k) dt. Served work is taken from the front of the
queue, so the work between two levels of the cumulative curves belongs to the step where each curve passes there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Delays(NamedTuple):
    """Delay of all work of one or several sites, weighted by work."""

    mean_s: float
    p50_s: float
    p95_s: float
    p99_s: float
    arrived_kws: float
    """All work that arrived, kW s."""
    unserved_kws: float
    """Work still queued at the end, kW s; it counts above with its age at the end."""


def fcfs_delays(arrived_kw: np.ndarray, served_kw: np.ndarray, dt_s: float) -> Delays:
    """Delays from the work that arrived and was served in each step, both (n_step, n_site), kW.

    Work unserved at the end counts as if it were served in the step after the last. The q-quantile is the least delay
    that the share q of the work does not exceed; all are 0 where no work arrived.
    """
    n_step = len(arrived_kw)
    work, wait = [np.zeros(0)], [np.zeros(0)]
    unserved = 0.0
    for arrived, served in zip(np.cumsum(arrived_kw, axis=0).T, np.cumsum(served_kw, axis=0).T, strict=True):
        total = arrived[-1] if n_step else 0.0
        if total <= 0.0:
            continue
        rounding = 1e-9 * total
        served = np.minimum(served, total)
        served = np.where(served > total - rounding, total, served)
        levels = np.unique(np.concatenate(([0.0], arrived, served)))
        middle, width = 0.5 * (levels[1:] + levels[:-1]), np.diff(levels)
        real = width > rounding
        came = np.searchsorted(arrived, middle[real], side="left")
        left = np.searchsorted(served, middle[real], side="left")  # n_step where never served
        work.append(width[real])
        wait.append(np.maximum(left - came, 0) * dt_s)
        unserved += total - served[-1]
    weight, delay = np.concatenate(work), np.concatenate(wait)
    if weight.size == 0:
        return Delays(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    order = np.argsort(delay, kind="stable")
    share = np.cumsum(weight[order]) / weight.sum()
    p50, p95, p99 = (delay[order][min(np.searchsorted(share, q - 1e-12), len(share) - 1)] for q in (0.5, 0.95, 0.99))
    return Delays(
        mean_s=float(np.average(delay, weights=weight)),
        p50_s=float(p50),
        p95_s=float(p95),
        p99_s=float(p99),
        arrived_kws=float(arrived_kw.sum() * dt_s),
        unserved_kws=float(unserved * dt_s),
    )
