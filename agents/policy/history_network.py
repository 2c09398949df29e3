"""A network that also sees how what it observes has changed over its last steps.

    input = (o_t, c_t - c_t-1, c_t-1 - c_t-2, .. c_t-n+1 - c_t-n)

with o the observation and c some columns of it. So a perceptron can continue a ramp, such as the edge of a cloud, and
separate its own effect from that of others. Steps before an episode's first changed nothing. Changes are
given rather than earlier values: a voltage moves by thousandths of the band from one second to the next, which a
normalised value would hide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, ClassVar, Self

import numpy as np

from dcgrid_env.agents.policy.neural_network import Network, PolicyError
from dcgrid_env.core.arrays import Array, namespace

MOST_STEPS = 1000
"""Longest history that there is."""


def with_changes(
    observation: Array, earlier: tuple[Any, ...] | None, columns: Array, steps: int
) -> tuple[Any, tuple[Any, ...]]:
    """Observation and the last changes of its columns, and what to remember for the next step; NumPy or torch.

    Parameters
    ----------
    observation
        What is seen now, (..., n).
    earlier
        Its columns in the last ``steps`` steps, newest first, (..., n_column) each; None at an episode's beginning.
    columns
        Which columns, (n_column,).
    steps
        How many changes of each.

    Returns
    -------
    tuple
        Input of the network, (..., n + steps n_column), newest change first, and the columns of the last steps.
    """
    recent = observation[..., columns]
    seen = (recent, *((recent,) * steps if earlier is None else earlier))
    changes = (later - before for later, before in pairwise(seen))
    return namespace(observation).concat((observation, *changes), axis=-1), seen[:steps]


class HistoryNetwork:
    """A perceptron on the observation and the last changes of some of its columns.

    Parameters
    ----------
    network
        From observation and changes to the output; its normalisation is of both.
    columns
        Columns of the observation whose changes it sees.
    steps
        How many changes of each, of the last steps.

    Raises
    ------
    PolicyError
        For columns or steps that do not fit.
    """

    family: ClassVar[str] = "history"

    def __init__(self, network: Network, columns: Sequence[int], steps: int):
        whole = isinstance(steps, int) and not isinstance(steps, bool)
        if not (whole and 1 <= steps <= MOST_STEPS):
            raise PolicyError(f"steps is {steps!r}; give a whole number of 1 .. {MOST_STEPS}")
        if not columns or not all(isinstance(column, int) for column in columns):
            raise PolicyError(f"columns are {columns!r}; give at least one whole number")
        self.network, self.columns, self.steps = network, np.array(columns, dtype=np.int64), steps
        if self.n_in < 1 or min(columns) < 0 or max(columns) >= self.n_in:
            raise PolicyError(
                f"columns are {list(columns)}; with {steps} changes of each the network, which takes {network.n_in} "
                f"figures, leaves {self.n_in} to be observed: give some of those, from 0 on"
            )

    @property
    def n_in(self) -> int:
        """Width of the observation."""
        return self.network.n_in - self.steps * len(self.columns)

    @property
    def n_out(self) -> int:
        """Width of the output."""
        return self.network.n_out

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Output at an episode's beginning, float32, (..., n_out), for an observation (..., n_in)."""
        return self.advance(observation, None)[0]

    def advance(
        self, observation: np.ndarray, memory: tuple[np.ndarray, ...] | None
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """Output, float32, (..., n_out), for an observation (..., n_in), and the columns of the last steps.

        ``memory`` is the one that the last step returned, None at an episode's beginning.
        """
        seen = np.asarray(observation, dtype=np.float32)
        wide, memory = with_changes(seen, memory, self.columns, self.steps)
        return self.network(wide), memory

    def arrays(self) -> dict[str, np.ndarray]:
        """Those of its perceptron."""
        return self.network.arrays()

    def settings(self) -> dict[str, Any]:
        """Columns, steps, and the perceptron's settings."""
        return {"columns": self.columns.tolist(), "steps": self.steps, "network": self.network.settings()}

    @classmethod
    def read(cls, arrays: Mapping[str, np.ndarray], settings: Mapping[str, Any]) -> Self:
        """The network of these arrays and settings."""
        return cls(Network.read(arrays, settings["network"]), settings["columns"], settings["steps"])


def remembers(network: Any) -> bool:
    """Return whether a network's output also depends on earlier observations, in NumPy or in torch."""
    return hasattr(network, "advance")


def outputs_of(
    networks: Mapping[str, Any], inputs: Mapping[str, Any], memory: dict[str, tuple[Any, ...]]
) -> dict[str, Any]:
    """What each network gives for its input.

    ``memory`` has what each network that remembers keeps, nothing at the beginning of episodes; it is brought up to
    date.
    """
    outputs = {}
    for name, network_input in inputs.items():
        network = networks[name]
        if remembers(network):
            outputs[name], memory[name] = network.advance(network_input, memory.get(name))
        else:
            outputs[name] = network(network_input)
    return outputs
