"""The figures of an episode whose course comes in parts: what ``Series.metrics`` gives of a whole one, to rounding."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dcgrid_env.core.metric import Combined, Metric, Streaming, cost_metric
from dcgrid_env.engine.fluctuation_by_parts import FluctuationByParts
from dcgrid_env.engine.grid_metrics import grid_figures, phase_figures
from dcgrid_env.engine.metric_list import METRICS
from dcgrid_env.engine.metrics import Series
from dcgrid_env.engine.state import over_arrays
from dcgrid_env.scenario.scenario import Scenario

_SQUARE = Metric("mean square", "mean square of |V-1|", "p.u.", 4, "lower", over_parts="mean")


class FiguresByParts:
    """Accumulates the figures of one lane's episode."""

    def __init__(self, scenario: Scenario):
        self.scenario = scenario
        self._grid: Combined | None = None
        self._fluctuation = FluctuationByParts(scenario)
        self._outside = np.zeros(len(scenario.feeder.load_nodes), bool)
        self._devices: list[Streaming] = []

    def add(self, part: Series) -> None:
        """Take the next steps of the episode, from the end of the part before on."""
        s, steps = self.scenario, len(part.cost_j)
        figures = grid_figures(part) | phase_figures(part) | part.after_loss()
        if self._grid is None:
            self._grid = Combined((*METRICS.values(), *(cost_metric(name, name) for name in part.costs), _SQUARE))
            self._devices = [_of_device(device, part, i) for i, device in enumerate(s.devices)]
        std, mean = figures.pop("voltage_deviation_std_pu"), figures["voltage_deviation_mean_pu"]
        del figures["outside_buses_pct"]
        self._grid.add(figures | {_SQUARE.name: std * std + mean * mean}, steps)
        v = part.v_pu[1:, s.feeder.load_slice]
        self._outside |= (np.abs(v - 1.0) > s.band_pu).any(axis=0)
        self._fluctuation.add(part.v_pu, part.p_kw_from_reset)
        for own, history in zip(self._devices, part.devices, strict=True):
            own.add(history, steps)

    def figures(self) -> dict[str, float]:
        """Those of all parts so far, in the order of ``Series.metrics``; ValueError before the first."""
        if self._grid is None:
            raise ValueError("no step has been recorded yet")
        figures = self._grid.figures()
        mean = figures["voltage_deviation_mean_pu"]
        figures["voltage_deviation_std_pu"] = math.sqrt(max(figures.pop(_SQUARE.name) - mean * mean, 0.0))
        figures["outside_buses_pct"] = 100.0 * self._outside.mean()
        figures |= self._fluctuation.figures()
        for own in self._devices:
            figures |= own.figures()
        return {name: float(value) for name, value in figures.items()}


def _of_device(device: Any, part: Series, i: int) -> Streaming:
    """An accumulator for a device's figures: its own, rules, or its whole course where there are neither."""
    dt_s, requests = part.scenario.dt_s, part.requests() if device.input == "workload" else None
    if hasattr(device, "by_parts"):
        return device.by_parts(dt_s, requests)
    if all(name in METRICS and METRICS[name].over_parts for name in device.metrics(part.devices[i], dt_s, requests)):
        return _ByRules(device, dt_s, requests)
    return _Whole(device, dt_s, requests)


class _ByRules:
    """Figures that rules join."""

    def __init__(self, device: Any, dt_s: float, requests: Any):
        self._metrics = lambda history: device.metrics(history, dt_s, requests)
        self._combined = Combined(METRICS.values())

    def add(self, history: Any, steps: int) -> None:
        self._combined.add(self._metrics(history), steps)

    def figures(self) -> dict[str, float]:
        return self._combined.figures()


class _Whole:
    """Figures of which nothing is said: the device's course is kept, which grows with the episode."""

    def __init__(self, device: Any, dt_s: float, requests: Any):
        self._metrics = lambda history: device.metrics(history, dt_s, requests)
        self._parts: list[Any] = []

    def add(self, history: Any, steps: int) -> None:
        own = over_arrays(lambda values: np.array(values[1:] if self._parts else values), history)
        self._parts.append(own)

    def figures(self) -> dict[str, float]:
        return self._metrics(over_arrays(lambda *parts: np.concatenate(parts), *self._parts))
