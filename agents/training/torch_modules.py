"""Networks while they are trained, in torch, each of which becomes one of NumPy arrays."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from dcgrid_env.agents.policy.history_network import HistoryNetwork, with_changes
from dcgrid_env.agents.policy.monotone import UNITS, WIDTH, Head, MonotoneNetwork, head_output
from dcgrid_env.agents.policy.neural_network import Network
from dcgrid_env.agents.training.row_batch import CLIP
from dcgrid_env.agents.training.run_folder import torch

SMALL = 0.1
"""Factor on the last layer's weights at the beginning: actions begin near what an output of 0 means."""


class Perceptron(torch.nn.Module):
    """A multilayer perceptron on normalised observations, see :class:`Network`.

    Parameters
    ----------
    mean, std
        Mean and standard deviation of the observation, (n_in,) each.
    n_out
        Width of the output.
    hidden
        Widths of the hidden layers.
    """

    mean: torch.Tensor
    std: torch.Tensor

    def __init__(self, mean: torch.Tensor, std: torch.Tensor, n_out: int, hidden: Sequence[int]):
        super().__init__()
        self.register_buffer("mean", mean)
        self.register_buffer("std", std)
        widths = [len(mean), *hidden, n_out]
        self.layers = torch.nn.ModuleList(torch.nn.Linear(a, b) for a, b in itertools.pairwise(widths))
        with torch.no_grad():
            last = self.layers[-1]
            last.weight.mul_(SMALL)  # pyright: ignore[reportCallIssue]
            last.bias.zero_()  # pyright: ignore[reportCallIssue]
        self.skip = torch.nn.Parameter(torch.zeros(len(mean), n_out))

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Output, (..., n_out), for observations (..., n_in)."""
        x = normalised = ((observation - self.mean) / self.std).clamp(-CLIP, CLIP)
        for i, layer in enumerate(self.layers):
            x = layer(torch.nn.functional.silu(x) if i else x)
        return x + normalised @ self.skip

    def exported(self) -> Network:
        """The network as NumPy arrays."""
        layers = [(numpy_of(layer.weight).T, numpy_of(layer.bias)) for layer in self.layers]  # pyright: ignore
        return Network(layers, "silu", "none", numpy_of(self.mean), numpy_of(self.std), CLIP, numpy_of(self.skip))


class HistoryPerceptron(torch.nn.Module):
    """A perceptron that also sees how its observation changed, see :class:`HistoryNetwork`.

    Parameters
    ----------
    mean, std
        Mean and standard deviation of the observation and of the changes, (n_in + steps len(columns),) each.
    n_out, hidden
        See :class:`Perceptron`.
    columns, steps
        Columns of the observation whose last ``steps`` changes it sees.
    """

    def __init__(
        self,
        mean: torch.Tensor,
        std: torch.Tensor,
        n_out: int,
        hidden: Sequence[int],
        columns: Sequence[int],
        steps: int,
    ):
        super().__init__()
        self.network, self.columns, self.steps = Perceptron(mean, std, n_out, hidden), list(columns), steps
        with torch.no_grad():  # changes are large beside what they should move: begin near a network without them
            first = self.network.layers[0]
            first.weight[:, -steps * len(self.columns) :].mul_(SMALL)  # pyright: ignore

    def advance(
        self, observation: torch.Tensor, memory: tuple[torch.Tensor, ...] | None
    ) -> tuple[torch.Tensor, tuple[torch.Tensor, ...]]:
        """Output, (..., n_out), for observations (..., n_in), and what to remember."""
        wide, memory = with_changes(observation, memory, self.columns, self.steps)
        return self.network(wide), memory

    def exported(self) -> HistoryNetwork:
        """The network as NumPy arrays."""
        return HistoryNetwork(self.network.exported(), self.columns, self.steps)


class Monotone(torch.nn.Module):
    """Monotone heads, see :class:`MonotoneNetwork`.

    Parameters
    ----------
    mean, std
        Mean and standard deviation of the observation, (n_in,) each; its first figure is the voltage's deviation.
    columns
        What each head may see.
    slopes
        Largest slope of each head.
    offsets
        Which heads have an offset.
    hidden
        Widths of the context networks' hidden layers.
    """

    def __init__(
        self,
        mean: torch.Tensor,
        std: torch.Tensor,
        columns: Sequence[Sequence[int]],
        slopes: Sequence[float],
        offsets: Sequence[bool],
        hidden: Sequence[int],
    ):
        super().__init__()
        self.n_in, self.slopes, self.offsets = len(mean), tuple(slopes), tuple(offsets)
        self.columns = [list(head_columns) for head_columns in columns]
        self.contexts = torch.nn.ModuleList(
            Perceptron(mean[head_columns], std[head_columns], WIDTH, hidden) for head_columns in self.columns
        )
        wide = torch.log(torch.linspace(0.1, 1.0, UNITS)).repeat(len(self.columns), 1)
        self.log_widths = torch.nn.Parameter(wide.to(mean.device))

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Output, (..., n_out), for observations (..., n_in)."""
        z, widths = observation[..., 0], torch.exp(self.log_widths)
        outputs = [
            head_output(z, context(observation[..., head_columns]), widths[i], self.slopes[i], self.offsets[i])
            for i, (context, head_columns) in enumerate(zip(self.contexts, self.columns, strict=True))
        ]
        return torch.stack(outputs, dim=-1)

    def exported(self) -> MonotoneNetwork:
        """The network as NumPy arrays."""
        widths = numpy_of(torch.exp(self.log_widths))
        heads = [
            Head(context.exported(), np.array(head_columns), widths[i], self.slopes[i], self.offsets[i])  # pyright: ignore
            for i, (context, head_columns) in enumerate(zip(self.contexts, self.columns, strict=True))
        ]
        return MonotoneNetwork(heads, self.n_in)


def numpy_of(tensor: torch.Tensor) -> np.ndarray:
    """A tensor's figures."""
    return tensor.detach().cpu().numpy()


class _ForgivingClip(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, low: Any, high: Any) -> torch.Tensor:
        ctx.save_for_backward(x)
        ctx.limits = low, high
        return x.clamp(low, high)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: torch.Tensor) -> Any:
        (weight,), (x,), (low, high) = grad_outputs, ctx.saved_tensors, ctx.limits
        outwards = ((x > high) & (weight < 0.0)) | ((x < low) & (weight > 0.0))
        return torch.where(outwards, 0.0, weight), None, None


def forgiving_clip(x: torch.Tensor, low: float | torch.Tensor, high: float | torch.Tensor) -> torch.Tensor:
    """Cut to these limits: what a step beyond would gain has no derivative, what a step back would gain has."""
    return _ForgivingClip.apply(x, low, high)  # pyright: ignore[reportReturnType]


LARGEST = 1e9
"""Largest component of a derivative that goes on backward. If the loop of policy and grid is unstable, the derivative
grows by a factor of 4 and more in each step, and float32 ends at 3e38."""


def without_overflow(actions: torch.Tensor) -> torch.Tensor:
    """Return the actions unchanged; scale their derivative down, episode by episode, to ``LARGEST`` at most.

    Parameters
    ----------
    actions
        Those of a step, (..., n_action), on the way from the policy to the grid.
    """
    actions.register_hook(_scaled)
    return actions


def _scaled(derivative: torch.Tensor) -> torch.Tensor:
    # Where nothing is too large the factor is exactly 1: the derivative is the same to the bit.
    return derivative * (LARGEST / derivative.abs().amax(-1, keepdim=True).clamp(min=LARGEST))


def cosine(learning_rate: float, iteration: int, iterations: int) -> float:
    """Return the learning rate of an iteration, from 1 on; it decays to zero along a cosine."""
    return 0.5 * learning_rate * (1.0 + math.cos(math.pi * (iteration - 1) / iterations))
