"""Recordings of several batches as one, each of some of its lanes: on random feeders a batch for each feeder."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dcgrid_env.engine.metrics import Recorder, Series
from dcgrid_env.scenario.scenario import Scenario


class JoinedRecorder(Recorder):
    """What ``Recorder`` has, over recordings that are made elsewhere.

    Parameters
    ----------
    scenario
        What they are members of.
    parts
        Each with its lanes, in the order of its own.
    """

    def __init__(self, scenario: Scenario, parts: Sequence[tuple[np.ndarray, Recorder]]):
        self.scenario, self._parts = scenario, list(parts)
        places = [(int(lane), k, i) for k, (lanes, _) in enumerate(parts) for i, lane in enumerate(lanes)]
        self._place = {lane: (k, i) for lane, k, i in places}

    def add(self, transition: object) -> None:
        """TypeError: steps are recorded where they are made."""
        raise TypeError("a joined recorder takes no steps; add them to its parts")

    @property
    def over(self) -> bool:
        """Whether the episode has ended in every lane."""
        return all(part.over for _, part in self._parts)

    def lane(self, lane: int) -> Series:
        """The course of one lane's episode, on its own feeder."""
        part, own = self._place[lane]
        return self._parts[part][1].lane(own)

    def costs(self) -> np.ndarray:
        """J of each lane's episode, (lane,)."""
        whole = np.empty(len(self._place))
        for lanes, part in self._parts:
            whole[lanes] = part.costs()
        return whole

    def metrics(self) -> list[dict[str, float]]:
        """The figures of each lane's episode."""
        return [self.lane(i).metrics() for i in range(len(self._place))]
