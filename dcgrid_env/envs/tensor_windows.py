"""Windows of long episodes as one batch of tensors, which makes their gradient much faster.

A gradient through thousands of steps in sequence is slow, because most of the time is overhead of single operations.
Here an episode is cut into windows that are stepped together. Each begins in a state of the native environment. The
gradient of a window by its initial state is the value of the final state of the window before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dcgrid_env.core.arrays import Array, as_like, namespace
from dcgrid_env.engine.cost import reward
from dcgrid_env.engine.physics import connections, dynamics
from dcgrid_env.engine.physics.state import Exogenous, State, over_arrays
from dcgrid_env.envs.tensor import drawn_outside
from dcgrid_env.scenario.scenario import Scenario


class TensorWindows:
    """A batch of windows, ordered by window and then by episode.

    Parameters
    ----------
    scenario
        The scenario; its split defines which episodes the seeds select.
    seeds
        One episode each.
    starts
        Step at which each window begins, 0 at first.
    like
        An array of the wanted kind and precision, such as ``torch.empty(0, dtype=torch.float64)``.
    """

    def __init__(self, scenario: Scenario, seeds: Sequence[int], starts: Sequence[int], like: Array):
        self.scenario, self.like = scenario.member(seeds), like
        outside, buses = drawn_outside(self.scenario, np.asarray(seeds, np.uint64))
        self._outside = outside.map(lambda series: as_like(series, like))
        self._starts = np.repeat(np.asarray(starts), len(seeds))
        self._episodes = np.tile(np.arange(len(seeds)), len(starts))
        placed = connections.placement(self.scenario, buses[self._episodes])
        self._nodes, self._legs = self._index(placed.nodes), self._index(placed.legs)
        self.step_number = 0
        """Steps since the windows began."""
        self.state: State

    def begin(self, states: Sequence[State]) -> State:
        """Set the initial states: those of all episodes at each start, as NumPy arrays."""
        joined = over_arrays(lambda *parts: np.concatenate(parts), *states)
        self.state, self.step_number = joined.map(self._as_like), 0
        return self.state

    def step(self, action: Array) -> Array:
        """Advance every window by joint actions, (window, n_action).

        Returns
        -------
        Array
            The step's share of J times T, (window,); 0 after the end of the episode.
        """
        self.step_number += 1
        s, horizon = self.scenario, self.scenario.horizon
        step = self._starts + self.step_number
        step_and_episode = (self._index(np.minimum(step, horizon)), self._index(self._episodes))
        self.state, grid = dynamics.step(s, self.state, action, self._exogenous(step_and_episode))
        last, live = (as_like(mask.astype(np.float64), self.like) for mask in (step == horizon, step <= horizon))
        return reward.total(reward.team_costs(s, self.state, grid.solution, last)) * live

    def _exogenous(self, step_and_episode: tuple[Array, Array]) -> Exogenous:
        now: dict[str, Any] = self._outside.map(lambda series: series[step_and_episode]).inputs
        return Exogenous(**now, nodes=self._nodes, legs=self._legs)

    def _as_like(self, values: np.ndarray) -> Array:
        return as_like(values, self.like) if values.dtype.kind == "f" else self._index(values)

    def _index(self, positions: np.ndarray) -> Array:
        return namespace(self.like).asarray(np.ascontiguousarray(positions))
