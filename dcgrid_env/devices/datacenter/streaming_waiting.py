"""Streaming waiting times of queued work, first come first served.

The figures equal those that ``waiting_time`` computes from whole curves. Only two things are kept: work that still
waits, with the step of its arrival, and the amount of served work for each number of steps waited. Quantiles are exact
because a wait is a whole number of steps.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env.devices.datacenter.waiting_time import Delays


class _Queue:
    """Work of one site and class that waits, in the order of its arrival."""

    def __init__(self) -> None:
        self.came = np.zeros(0, np.int64)
        self.amount = np.zeros(0)
        self.arrived = 0.0
        self.served_by_wait = np.zeros(0)
        """Work by the steps that it has waited."""

    def serve(self, arrived: np.ndarray, served: np.ndarray, first: int) -> None:
        """Put in what arrives in some steps, the first of which is ``first``, and take out what is served in them."""
        came = np.concatenate((self.came, first + np.arange(len(arrived))))
        amount = np.concatenate((self.amount, arrived))
        self.arrived += float(arrived.sum())
        rounding = 1e-9 * self.arrived
        level = np.cumsum(amount)
        whole = level[-1]
        if whole <= 0.0:
            return
        done = np.minimum(np.cumsum(served), whole)
        done = np.where(done > whole - rounding, whole, done)
        edges = np.unique(np.concatenate(([0.0], level, done)))
        middle, width = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
        taken = (middle < done[-1]) & (width > rounding)
        entry = np.searchsorted(level, middle[taken], side="left")
        left = first + np.searchsorted(done, middle[taken], side="left")
        self.served_by_wait = added(self.served_by_wait, np.maximum(left - came[entry], 0), width[taken])
        rest = np.minimum(amount, np.maximum(level - done[-1], 0.0))
        waits = rest > 0.0
        self.came, self.amount = came[waits], rest[waits]

    def by_wait(self, steps: int) -> np.ndarray:
        """Work by the steps that it has waited at the end of an episode of ``steps``, what still waits with its age."""
        real = self.amount > 1e-9 * self.arrived
        return added(self.served_by_wait, steps - self.came[real], self.amount[real])


def added(work_by_steps: np.ndarray, steps: np.ndarray, work: np.ndarray) -> np.ndarray:
    """Work by a number of steps, (most steps + 1,), with more of it, (n,), by its steps, whole numbers (n,)."""
    if not len(steps):
        return work_by_steps
    more = np.bincount(steps, work, minlength=len(work_by_steps))
    more[: len(work_by_steps)] += work_by_steps
    return more


class WaitingTimes:
    """Delays of all work of one or several sites."""

    def __init__(self, dt_s: float):
        self.dt_s = dt_s
        self.steps = 0
        self._queues: list[_Queue] = []

    def add(self, arrived_kw: np.ndarray, served_kw: np.ndarray) -> None:
        """Take the work that arrived and was served in further steps, both (n_step, n_site), kW."""
        if not self._queues:
            self._queues = [_Queue() for _ in arrived_kw.T]
        for queue, arrived, served in zip(self._queues, arrived_kw.T, served_kw.T, strict=True):
            queue.serve(arrived, served, self.steps)
        self.steps += len(arrived_kw)

    def delays(self) -> Delays:
        """Those of all steps so far as if the episode ended here, see ``waiting_time.fcfs_delays``."""
        of_queues = [queue.by_wait(self.steps) for queue in self._queues]
        work = np.zeros(max(map(len, of_queues), default=0))
        for queued in of_queues:
            work[: len(queued)] += queued
        whole = work.sum()
        if whole <= 0.0:
            return Delays(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        wait_s = np.arange(len(work)) * self.dt_s
        share = np.cumsum(work) / whole
        p50, p95, p99 = (
            float(wait_s[min(np.searchsorted(share, q - 1e-12), len(share) - 1)]) for q in (0.5, 0.95, 0.99)
        )
        return Delays(
            mean_s=float(wait_s @ work / whole),
            p50_s=p50,
            p95_s=p95,
            p99_s=p99,
            arrived_kws=sum(queue.arrived for queue in self._queues) * self.dt_s,
            unserved_kws=sum(float(queue.amount.sum()) for queue in self._queues) * self.dt_s,
        )
