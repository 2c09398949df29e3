"""The gradient of episodes' costs by every action in them, from windows that are differentiated side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from dcgrid_env import Scenario, TensorWindows
from dcgrid_env.core.torch_threads import one_torch_thread

WINDOW = 300
"""Steps of a window."""


class CostGradient:
    """Gradients of episodes along trajectories that differ a little from one call to the next.

    Parameters
    ----------
    scenario, seeds
        The episodes.
    """

    def __init__(self, scenario: Scenario, seeds: Sequence[int]):
        self.starts = tuple(range(0, scenario.horizon, WINDOW))
        self._horizon, self._n_episode = scenario.horizon, len(seeds)
        self._windows = TensorWindows(scenario, seeds, self.starts, torch.empty(0, dtype=torch.float64))
        self._prices: Sequence[torch.Tensor | None] = ()

    def settle(self, actions: np.ndarray, states: Sequence[Any]) -> None:
        """Carry the price of what a window leaves to the next from the last window to the first."""
        for _ in self.starts[1:]:
            self(actions, states)

    def __call__(self, actions: np.ndarray, states: Sequence[Any]) -> np.ndarray:
        """The derivative of J times the horizon, (step, episode, n_action).

        The price of what a window's end leaves to the next window is that of the last call: see :meth:`settle`.

        Parameters
        ----------
        actions
            (step, episode, n_action).
        states
            State of all episodes at each of ``starts``, under these actions.
        """
        begun = self._windows.begin(states)
        self._windows.state = begun.map(lambda a: a.clone().requires_grad_() if a.is_floating_point() else a)
        leaves = _floating(self._windows.state)
        ends = [min(start + WINDOW, self._horizon) for start in self.starts]
        given = np.zeros((min(WINDOW, self._horizon), len(self.starts), self._n_episode, actions.shape[-1]))
        for i, (start, end) in enumerate(zip(self.starts, ends, strict=True)):
            given[: end - start, i] = actions[start:end]
        taken = torch.from_numpy(given.reshape(len(given), -1, actions.shape[-1])).requires_grad_()
        with one_torch_thread():
            total = torch.stack([self._windows.step(action).sum() for action in taken]).sum()
            later = self._n_episode
            for array, price in zip(_floating(self._windows.state), self._prices, strict=bool(self._prices)):
                if price is not None:
                    total = total + (array[:-later] * price[later:]).sum()
            by_action, *self._prices = torch.autograd.grad(total, [taken, *leaves], allow_unused=True)
        by_window = by_action.numpy().reshape(given.shape)  # pyright: ignore[reportOptionalMemberAccess]
        parts = [by_window[: end - start, i] for i, (start, end) in enumerate(zip(self.starts, ends, strict=True))]
        return np.concatenate(parts)


def _floating(state: Any) -> list[torch.Tensor]:
    """The arrays of a state that have a derivative, in a fixed order."""
    found: list[torch.Tensor] = []
    state.map(lambda array: found.append(array) or array)
    return [array for array in found if array.is_floating_point()]
