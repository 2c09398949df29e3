"""Records episodes of any length: steps are held until they make a part, which is summed up and let go."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from dcgrid_env.engine.figures_by_parts import FiguresByParts
from dcgrid_env.engine.metrics import Series
from dcgrid_env.engine.state import over_arrays
from dcgrid_env.scenario.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.engine.simulation import Transition

WHOLE_COURSE_BYTES = 256 * 2**20
"""Largest course that a run keeps whole; beyond, it is recorded in parts."""
_PART_BYTES = 48 * 2**20
_PART_STEPS = 16, 1024
_ARRAY_BYTES = 112
"""What an array takes beside its values."""

if TYPE_CHECKING:
    from dcgrid_env.engine.simulation import Transition


class PartSink(Protocol):
    """Takes the course of episodes part by part, to write it or to draw it."""

    def add(self, parts: Sequence[Series | None], first_step: int) -> None:
        """Take the next steps of every lane.

        Parameters
        ----------
        parts
            One for each lane, from the end of the part before on; None where an episode has ended before.
        first_step
            Steps that the parts before had: the first of these is the one behind.
        """
        ...


class StreamingRecorder:
    """Collects the figures of one episode in every lane of a batch, in memory that does not grow with its length.

    The figures are those of ``Recorder`` to rounding, some 1e-12 of their size. The course itself is gone; ``sinks``
    are given it part by part.

    Parameters
    ----------
    scenario
        What is run.
    begun
        The transition of the reset.
    sinks
        What takes the course.
    part_steps
        Steps in a part; by default as many as fit into some 48 MiB, 16 to 1024.
    """

    def __init__(
        self, scenario: Scenario, begun: Transition, sinks: Sequence[PartSink] = (), part_steps: int | None = None
    ):
        self.scenario, self.sinks = scenario, tuple(sinks)
        values, arrays = _size(begun)
        fitting = _PART_BYTES // (values + arrays * _ARRAY_BYTES)
        self.part_steps = part_steps or int(np.clip(fitting, *_PART_STEPS))
        self._waiting = [begun]
        self._steps = 0
        lanes = len(begun.terminated)
        self._part_length = np.zeros(lanes, dtype=np.int64)
        self._over = np.zeros(lanes, dtype=bool)
        self._costs = np.zeros(lanes)
        self._figures = [FiguresByParts(scenario) for _ in range(lanes)]

    def add(self, transition: Transition) -> None:
        """Take a step's transition; a lane whose episode has ended before is not counted further."""
        self._part_length += ~self._over
        self._costs += np.where(self._over, 0.0, transition.cost_j)
        self._over |= transition.terminated | transition.truncated
        self._waiting.append(transition)
        if len(self._waiting) > self.part_steps or self.over:
            self._end_part()

    @property
    def over(self) -> bool:
        """Whether the episode has ended in every lane."""
        return bool(self._over.all())

    def costs(self) -> np.ndarray:
        """J of each lane's episode, (lane,); ValueError before all have ended."""
        if not self.over:
            raise ValueError("costs of an episode that has not ended; step until every lane is over")
        return self._costs / self.scenario.horizon

    def metrics(self) -> list[dict[str, float]]:
        """The figures of each lane's episode; ValueError before all have ended."""
        if not self.over:
            raise ValueError("metrics of an episode that has not ended; step until every lane is over")
        return [own.figures() for own in self._figures]

    def _end_part(self) -> None:
        parts = Series.of_lanes(self.scenario, self._waiting, self._part_length.tolist())
        for own, part in zip(self._figures, parts, strict=True):
            if part is not None:
                own.add(part)
        for sink in self.sinks:
            sink.add(parts, self._steps)
        self._steps += len(self._waiting) - 1
        del self._waiting[:-1]
        self._part_length[:] = 0


def course_bytes(scenario: Scenario, seeds: Sequence[int]) -> int:
    """Memory that :class:`Recorder` takes for the whole course of an episode of each seed, bytes.

    Beyond ``WHOLE_COURSE_BYTES`` a run uses :class:`StreamingRecorder`. The first episode is begun to find out.
    """
    from dcgrid_env.engine.simulation import Simulation  # brings the compiler with it

    values, arrays = _size(Simulation(scenario.member(seeds[0]), 1).reset([seeds[0]]))
    return scenario.horizon * (len(seeds) * values + arrays * _ARRAY_BYTES)


def _size(transition: Transition) -> tuple[int, int]:
    """Bytes of the values of a transition, and the number of its arrays."""
    sizes: list[int] = []

    def measure(values: Any) -> Any:
        sizes.append(getattr(values, "nbytes", 0))
        return values

    over_arrays(measure, tuple(transition))
    return sum(sizes), len(sizes)
