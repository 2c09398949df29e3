"""Networks that remember: run with what they keep of an episode's earlier steps, NumPy arrays and tensors alike."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from dcgrid_env.agents.policy.neural_network import PolicyError
from dcgrid_env.core.arrays import Array


@runtime_checkable
class Remembers(Protocol):
    """A network whose output also depends on what it saw before."""

    def advance(self, observation: Array, memory: tuple[Any, ...] | None) -> tuple[Any, tuple[Any, ...]]:
        """Output, (..., n_out), for an observation (..., n_in), and what it remembers from now on.

        ``memory`` is the one that the last call returned, None at an episode's beginning.
        """
        ...


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
        if isinstance(network, Remembers):
            outputs[name], memory[name] = network.advance(network_input, memory.get(name))
        else:
            outputs[name] = network(network_input)
    return outputs


def require_same_episodes(source: str, before: tuple[int, ...] | None, now: tuple[int, ...]) -> tuple[int, ...]:
    """The shape now; PolicyError, naming the policy, where what is remembered is of episodes of another shape."""
    if before not in (None, now):
        raise PolicyError(
            f"{source}: remembers episodes of shape {before} and is given observations of shape {now}; call "
            "reset(scenario) where other episodes begin, and give all environments at each step"
        )
    return now
