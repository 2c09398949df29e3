"""Recording of episodes of any length: steps are stored until they make a part, which is summarized and dropped."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.metric import Combined, Streaming
from dcgrid_env.devices.device import Device, DeviceState, Requests
from dcgrid_env.engine.cost.grid_metrics import AFTER_LOSS, StreamingGrid
from dcgrid_env.engine.cost.metric_list import METRICS
from dcgrid_env.engine.physics.state import over_arrays
from dcgrid_env.engine.record.episode_record import Series
from dcgrid_env.scenario.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.engine.simulation import Transition

WHOLE_COURSE_BYTES = 256 * 2**20
"""Largest trajectory, bytes, that a run keeps in memory; a larger one is streamed."""
_PART_BYTES = 48 * 2**20
_PART_STEPS = 16, 1024
_ARRAY_BYTES = 112
"""Memory of an array in addition to its values, bytes."""


class PartSink(Protocol):
    """Receives the trajectories of episodes in parts, to write or draw them."""

    def add(self, parts: Sequence[Series | None], first_step: int) -> None:
        """Take the next steps of every environment.

        Parameters
        ----------
        parts
            One for each environment, from the end of the part before on; None where an episode has ended before.
        first_step
            Steps that the parts before had: the first of these is the one behind.
        """
        ...


class StreamingRecorder:
    """Collects the figures of one episode in every environment of a batch, in memory independent of its length.

    The figures are those of ``Recorder`` to rounding, some 1e-12 of their size. The trajectory itself is not
    kept; ``sinks`` receive it in parts.

    Parameters
    ----------
    scenario
        What is run.
    initial
        The transition of the reset.
    sinks
        Receivers of the trajectory.
    part_steps
        Steps in a part; by default as many as fit into some 48 MiB, 16 to 1024.
    """

    def __init__(
        self, scenario: Scenario, initial: Transition, sinks: Sequence[PartSink] = (), part_steps: int | None = None
    ):
        self.scenario, self.sinks = scenario, tuple(sinks)
        values, arrays = _size(initial)
        fitting = _PART_BYTES // (values + arrays * _ARRAY_BYTES)
        self.part_steps = part_steps or int(np.clip(fitting, *_PART_STEPS))
        self._waiting = [initial]
        self._steps = 0
        n_env = len(initial.terminated)
        self._part_length = np.zeros(n_env, dtype=np.int64)
        self._over = np.zeros(n_env, dtype=bool)
        self._costs = np.zeros(n_env)
        self._figures = [_StreamingMetrics(scenario) for _ in range(n_env)]

    def add(self, transition: Transition) -> None:
        """Take a step's transition; an environment whose episode has ended before is not counted further."""
        self._part_length += ~self._over
        self._costs += np.where(self._over, 0.0, transition.cost_j)
        self._over |= transition.terminated | transition.truncated
        self._waiting.append(transition)
        if len(self._waiting) > self.part_steps or self.over:
            self._end_part()

    @property
    def over(self) -> bool:
        """Whether the episode has ended in every environment."""
        return bool(self._over.all())

    def costs(self) -> np.ndarray:
        """J of each environment's episode, (row,); ValueError before all have ended."""
        if not self.over:
            raise ValueError("costs of an episode that has not ended; step until every environment is over")
        return self._costs / self.scenario.horizon

    def metrics(self) -> list[dict[str, float]]:
        """The figures of each environment's episode; ValueError before all have ended."""
        if not self.over:
            raise ValueError("metrics of an episode that has not ended; step until every environment is over")
        return [metrics.figures() for metrics in self._figures]

    def _end_part(self) -> None:
        parts = Series.of_batch(self.scenario, self._waiting, self._part_length.tolist())
        for metrics, part in zip(self._figures, parts, strict=True):
            if part is not None:
                metrics.add(part)
        for sink in self.sinks:
            sink.add(parts, self._steps)
        self._steps += len(self._waiting) - 1
        del self._waiting[:-1]
        self._part_length[:] = 0


def course_bytes(scenario: Scenario, seeds: Sequence[int]) -> int:
    """Return the memory that :class:`Recorder` needs for an episode of each seed, bytes.

    Above ``WHOLE_COURSE_BYTES`` a run uses :class:`StreamingRecorder`. The first episode gives the size.
    """
    from dcgrid_env.engine.simulation import Simulation  # brings the compiler with it

    values, arrays = _size(Simulation(scenario.member(seeds[0]), 1).reset([seeds[0]]))
    return scenario.horizon * (len(seeds) * values + arrays * _ARRAY_BYTES)


def _size(transition: Transition) -> tuple[int, int]:
    """Bytes of the values of a transition, and the number of its arrays."""
    sizes: list[int] = []

    def measure(values: Array) -> Any:
        sizes.append(getattr(values, "nbytes", 0))
        return values

    over_arrays(measure, tuple(transition))
    return sum(sizes), len(sizes)


class _StreamingMetrics:
    """Accumulates the figures of one environment's episode."""

    def __init__(self, scenario: Scenario):
        self.scenario = scenario
        self._grid, self._after_loss = StreamingGrid(scenario), Combined(AFTER_LOSS)
        self._devices: list[Streaming] = []

    def add(self, part: Series) -> None:
        """Take the next steps of the episode, from the end of the part before on."""
        steps = len(part.cost_j)
        if not self._devices:
            self._devices = [_of_device(device, part, i) for i, device in enumerate(self.scenario.devices)]
        self._grid.add(part)
        for metrics, history in zip(self._devices, part.devices, strict=True):
            metrics.add(history, steps)
        self._after_loss.add(part.after_loss(), steps)

    def figures(self) -> dict[str, float]:
        """Those of all parts so far, in the order of ``Series.metrics``; ValueError before the first."""
        if not self._devices:
            raise ValueError("no step has been recorded yet")
        figures = self._grid.figures()
        for metrics in self._devices:
            figures |= metrics.figures()
        return {name: float(value) for name, value in (figures | self._after_loss.figures()).items()}


def _of_device(device: Any, part: Series, i: int) -> Streaming:
    """An accumulator for a device's figures: its own, rules, or its whole course where there are neither."""
    dt_s, requests = part.scenario.dt_s, part.requests() if device.input == "workload" else None
    if hasattr(device, "streaming"):
        return device.streaming(dt_s, requests)
    if all(name in METRICS and METRICS[name].over_parts for name in device.metrics(part.devices[i], dt_s, requests)):
        return _Combined(device, dt_s, requests)
    return _Whole(device, dt_s, requests)


class _Combined:
    """Figures that rules join."""

    def __init__(self, device: Device, dt_s: float, requests: Requests):
        self._metrics = lambda history: device.metrics(history, dt_s, requests)
        self._combined = Combined(METRICS.values())

    def add(self, history: DeviceState, steps: int) -> None:
        self._combined.add(self._metrics(history), steps)

    def figures(self) -> dict[str, float]:
        return self._combined.figures()


class _Whole:
    """Figures of which nothing is said: the device's course is kept, which grows with the episode."""

    def __init__(self, device: Device, dt_s: float, requests: Requests):
        self._metrics = lambda history: device.metrics(history, dt_s, requests)
        self._parts: list[Any] = []

    def add(self, history: DeviceState, steps: int) -> None:
        course = over_arrays(lambda values: np.array(values[1:] if self._parts else values), history)
        self._parts.append(course)

    def figures(self) -> dict[str, float]:
        return self._metrics(over_arrays(lambda *parts: np.concatenate(parts), *self._parts))
