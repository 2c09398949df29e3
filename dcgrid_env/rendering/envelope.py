"""A long episode reduced for a figure: the range of each quantity over a few hundred intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.engine.record.episode_record import Series
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.rendering.phase_curves import feeder_phases
from dcgrid_env.scenario.scenario import Scenario

INTERVALS = 720
"""Intervals that an episode is cut into at most: two minutes each of a day."""
LINE_POINTS = 120
"""Points of a line of means at most."""
_SHARES = (25, 50, 75)


class Spread(NamedTuple):
    """How a figure spreads over the intervals, and over all that have it."""

    low: np.ndarray
    """(interval,), and so on."""
    quartiles: np.ndarray
    """(interval, 3), the median in the middle."""
    high: np.ndarray


class Curves(NamedTuple):
    """Figures of several over the intervals, (interval, n) each."""

    low: np.ndarray
    mean: np.ndarray
    high: np.ndarray


class Lowest(NamedTuple):
    """The lowest voltage of an episode."""

    v_pu: float
    node: str
    at_s: float


class Envelope:
    """Time series of one environment's episode over intervals, collected part by part, see ``PartSink``.

    Parameters
    ----------
    scenario
        The scenario of the episode.
    env_index
        Position of the environment in the batch.
    """

    def __init__(self, scenario: Scenario, env_index: int = 0):
        self.scenario, self.env_index = scenario, env_index
        self.steps_each = math.ceil(scenario.horizon / INTERVALS)
        intervals = math.ceil(scenario.horizon / self.steps_each)
        self.intervals_a_mean = math.ceil(intervals / LINE_POINTS)
        """Intervals that a point of a line is the mean of."""
        self.cost = 0.0
        """J of what has been taken."""
        self.lowest = Lowest(math.inf, "", 0.0)
        self._waiting: dict[str, list[np.ndarray]] = {}
        self._spreads: dict[str, list[Spread]] = {}
        self._curves: dict[str, list[Curves]] = {}
        self._steps = 0
        feeder: Any = scenario.feeder
        self.groups: dict[str, np.ndarray] = (
            feeder_phases(feeder) if isinstance(feeder, ThreePhaseFeeder) else {"": feeder.load_nodes}
        )
        """Nodes whose voltages are shown together, by phase on a three-phase feeder."""

    @classmethod
    def from_series(cls, series: Series) -> Envelope:
        """That of a course that is there whole."""
        envelope = cls(series.scenario)
        envelope.add([series], 0)
        return envelope

    @property
    def t_s(self) -> np.ndarray:
        """Middles of the intervals, s, (interval,)."""
        begin = np.arange(0, self._steps, self.steps_each)
        end = np.minimum(begin + self.steps_each, self._steps)
        return 0.5 * (begin + end) * self.scenario.dt_s

    def add(self, parts: Sequence[Series | None], first_step: int) -> None:
        """Take the next steps of every environment."""
        part = parts[self.env_index]
        if part is None:
            return
        self.cost += float(part.cost_j.sum()) / self.scenario.horizon
        self._find_lowest(part, first_step)
        for name, values in self._figures(part).items():
            self._waiting.setdefault(name, []).append(np.array(values, np.float64))
        self._steps += len(part.cost_j)
        for name in self._waiting:
            self._cut(name, self.steps_each)

    def spread(self, name: str) -> Spread:
        """That of a figure by its name; "v" and the phase are voltages."""
        self._cut(name, 1)
        return Spread(*(np.concatenate(parts) for parts in zip(*self._spreads[name], strict=True)))

    def curves(self, name: str) -> Curves | None:
        """Those by a name, None where there are none."""
        if name not in self._waiting:
            return None
        self._cut(name, 1)
        return Curves(*(np.concatenate(parts) for parts in zip(*self._curves[name], strict=True)))

    def _figures(self, part: Series) -> dict[str, np.ndarray]:
        s = self.scenario
        figures = {f"v{name}": part.v_pu[1:, nodes] for name, nodes in self.groups.items()}
        if s.n_sites:
            figures["f_mhz"], figures["backlog_kws"] = part.f_mhz, part.backlog_kws[1:]
            workload = [device.input == "workload" for device in s.devices for _ in range(device.count)]
            figures["drawn_kw"] = part.p_kw[:, workload].sum(axis=1, keepdims=True)
        group = next((device for device in s.devices if device.kind == "storage" and device.count), None)
        if group is not None:
            figures["stored_pct"] = 100.0 * part.stored_kwh[1:] / group.parameters.energy_kwh
        if part.three_phase is not None:
            if part.three_phase.unbalance.shape[1]:
                figures["unbalance_pct"] = 100.0 * part.three_phase.unbalance[1:].max(axis=1, keepdims=True)
            figures["tap"] = part.three_phase.equipment.regulators.tap[1:]
        return figures

    def _find_lowest(self, part: Series, first_step: int) -> None:
        feeder = self.scenario.feeder
        v = part.v_pu[1:, feeder.load_slice]
        step, column = np.unravel_index(int(v.argmin()), v.shape)
        if v[step, column] < self.lowest.v_pu:
            node = feeder.node_ids[feeder.load_nodes[column]]
            self.lowest = Lowest(float(v[step, column]), node, (first_step + int(step) + 1) * self.scenario.dt_s)

    def _cut(self, name: str, least: int) -> None:
        """Reduce what waits to intervals; those of at least so many steps, or whole ones alone."""
        rows = sum(map(len, self._waiting[name]))
        whole = rows // self.steps_each
        if rows == 0 or (whole == 0 and rows < least):
            return
        waiting = np.concatenate(self._waiting[name])
        pieces = [waiting[: whole * self.steps_each].reshape(whole, self.steps_each, -1)] if whole else []
        rest = waiting[whole * self.steps_each :]
        if least < self.steps_each and len(rest):
            pieces, rest = [*pieces, rest[None]], rest[:0]
        self._waiting[name] = [rest.copy()]
        for piece in pieces:
            if name.startswith("v"):
                flat = piece.reshape(len(piece), -1)
                quartiles = np.percentile(flat, _SHARES, axis=1).T
                self._spreads.setdefault(name, []).append(Spread(flat.min(axis=1), quartiles, flat.max(axis=1)))
            else:
                curves = Curves(piece.min(axis=1), piece.mean(axis=1), piece.max(axis=1))
                self._curves.setdefault(name, []).append(curves)
