"""Streaming lateness of work, equal to that of ``lateness`` for a whole episode.

Only the work in line is kept, and of what was served how much was how many steps late.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env.devices.datacenter.lateness import Line, late_figures, line_up, serve_in_line
from dcgrid_env.devices.datacenter.streaming_waiting import added


class StreamingLateness:
    """Figures over all work of all sites; the arguments are those of ``lateness.lateness``."""

    def __init__(self, slack: tuple[int, int], interactive_share: float, by_deadline: bool, dt_s: float):
        self._rule = slack, interactive_share, by_deadline
        self.dt_s = dt_s
        self.steps = 0
        self._lines: list[Line | None] = []
        self._arrived = np.zeros(0)
        self._late = [np.zeros(0), np.zeros(0)]
        """Work by the steps that it was late, interactive and deferrable."""

    def add(self, arrived_kw: np.ndarray, moved_kw: np.ndarray, served_kw: np.ndarray) -> None:
        """Take the work of further steps, (n_step, n_site) each, kW."""
        if not self._lines:
            self._lines, self._arrived = [None] * arrived_kw.shape[1], np.zeros(arrived_kw.shape[1])
        self._arrived += arrived_kw.sum(axis=0)
        for i, (arrived, moved, served) in enumerate(zip(arrived_kw.T, moved_kw.T, served_kw.T, strict=True)):
            line = _joined(self._lines[i], line_up((arrived - moved, moved), *self._rule, self.steps))
            rounding = 1e-9 * self._arrived[i]
            late = self._late

            def note(step: int, taken: np.ndarray, line: Line = line, late: list[np.ndarray] = late) -> None:
                for kind, late_work in enumerate(line.lateness(step, taken)):
                    late[kind] = added(late[kind], late_work[0].astype(np.int64), late_work[1])

            left = serve_in_line(line, served, self.steps, rounding, note)
            waits = left > 0.0
            self._lines[i] = Line(*(column[..., waits] for column in line._replace(amount=left)))
        self.steps += len(arrived_kw)

    def figures(self) -> dict[str, float]:
        """Those of all steps so far as if the episode ended here."""
        late = list(self._late)
        for line, arrived in zip(self._lines, self._arrived, strict=True):
            if line is not None:
                left = np.where(line.amount > 1e-9 * arrived, line.amount, 0.0)
                kinds = zip(late, line.lateness(self.steps, left), strict=True)
                late = [added(x, steps.astype(np.int64), work) for x, (steps, work) in kinds]
        return late_figures([(np.arange(len(work), dtype=np.float64), work) for work in late], self.dt_s)


def _joined(waiting: Line | None, arriving: Line) -> Line:
    """Those in line and those that join it, in the order in which they are served."""
    if waiting is None or not len(waiting.amount):
        return arriving
    return Line(*(np.concatenate(parts, axis=-1) for parts in zip(waiting, arriving, strict=True))).in_order()
