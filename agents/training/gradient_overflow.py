"""A bound on derivatives that grow from step to step: they must not overflow on their way back through a window."""

from __future__ import annotations

from dcgrid_env.agents.training.run_folder import torch

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
