"""Train a policy whose gains stay below a linear stability bound.

The networks (``monotone``) are monotone in the agent's voltage and are trained as in ``analytic``. Bounds on their
slopes are computed from the feeder before training (``policy.slope_bounds``); ``margin`` scales them. Clock and
reactive power act on the same voltages, so the margin must leave room for both.

Limitation: the bounds hold for the linearised training feeder only. ``baselines.laws.stability`` lists what the
linearisation neglects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dcgrid_env import Scenario, field_names
from dcgrid_env.agents.algorithms.analytic import Analytic, Learner
from dcgrid_env.agents.algorithms.analytic import main as train
from dcgrid_env.agents.policy.agent_groups import PLAIN_CHANNELS, agent_groups
from dcgrid_env.agents.policy.slope_bounds import slope_bounds
from dcgrid_env.agents.training.run_folder import torch
from dcgrid_env.agents.training.torch_modules import Monotone
from dcgrid_env.baselines.controller import require_known_devices

TARGET_FIELDS = ("r", "x", "p_ref_next")
"""Inputs of the voltage target: electrical distance of the agent and coming demand of its site.

They must not depend on the policy's actions: that would close a second feedback loop without a bound."""


@dataclass(frozen=True)
class Safe(Analytic):
    """Train a monotone policy with bounded gain by gradients through the grid."""

    margin: float = 0.5
    """Maximum gain as a fraction of the stability bound."""


class SafeLearner(Learner):
    """Train monotone networks."""

    def __init__(self, cfg: Safe, grids: Sequence[Scenario]):
        for grid in grids:
            require_plain(grid)
        self.slopes = [cfg.margin * float(slope) for slope in np.min([slope_bounds(grid) for grid in grids], axis=0)]
        self.fields = field_names(grids[0])
        super().__init__(cfg, grids)

    def network(self, name: str, mean: torch.Tensor, std: torch.Tensor, n_out: int) -> torch.nn.Module:
        """Return the network for agents of this kind: clock and reactive power, or reactive power only."""
        fields = self.fields["dc_0" if name == "datacenter" else "inv_0"]
        n_own = len(fields)
        plates = [n_own, n_own + 1]  # draw and reach; the third figure of the nameplate holds the voltage
        inputs = [fields.index(field) for field in TARGET_FIELDS if field in fields] + plates
        reactive, clock = self.slopes
        if name == "datacenter":
            return Monotone(mean, std, [inputs, inputs], [clock, reactive], [True, False], self.cfg.hidden)
        return Monotone(mean, std, [inputs], [reactive], [False], self.cfg.hidden)


def require_plain(scenario: Scenario) -> None:
    """Raise ValueError for agents or channels without a known bound on the gain."""
    require_known_devices("safe training", scenario)
    for group in agent_groups(scenario).values():
        if group.channels != PLAIN_CHANNELS[group.kind]:
            raise ValueError(
                f"safe training bounds clocks and reactive power alone; on {scenario.name!r} agents of kind "
                f"{group.kind} have the channels {', '.join(group.channels)}: train analytic there"
            )


def main(cfg: Safe) -> Path:
    """Train a policy and return the output folder."""
    if cfg.view != "shared" or cfg.observe != "local":
        raise ValueError(f"view is {cfg.view!r} and observe {cfg.observe!r}; a safe policy is shared and local")
    if cfg.history:
        raise ValueError(f"history is {cfg.history}; the bound on the gain is that of a policy without one: give 0")
    return train(cfg, SafeLearner)
