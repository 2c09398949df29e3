"""Train an affine local rule with the cross-entropy method, as a baseline for learned policies.

Each set point of an agent is that of the tuned droop plus an affine function of the agent's observation and nameplate
figures. All agents of a kind share its numbers, about 40 for data centres and inverters together. The initial mean is
the tuned droop.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from dcgrid_env.agents.algorithms.cem import Cem, main

__all__ = ["Affine", "main"]


@dataclass(frozen=True)
class Affine(Cem):
    """Train an affine local rule with the cross-entropy method."""

    hidden: tuple[int, ...] = ()
    outputs: Literal["change", "droop", "constant"] = "droop"
    num_envs: int = 256
    population: int = 64
    elites: int = 10
    iterations: int = 60
    std: float = 0.1
    extra_std: float = 0.02
