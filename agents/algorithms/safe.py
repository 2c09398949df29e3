"""A safe policy: monotone in the own voltage, its gain below the linear stability bound whatever it learns.

The networks are those of ``monotone``, trained as ``analytic`` trains. The bounds on their slopes come from the feeder
before training (``policy.slope_bounds``), and the margin is a share of them: both axes together move a voltage that
both see, and the margin must leave room for that. They are of the linearised feeder, see ``baselines.laws.stability``
for what that leaves out, and of the feeder that was trained on.
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
"""What moves the voltage that is aimed at: where the agent stands, and what its site is about to draw. Nothing here
depends on what the policy does, or it would be a second loop without a bound."""


@dataclass(frozen=True)
class Safe(Analytic):
    """Train a policy by gradients through the grid that is monotone and of bounded gain."""

    margin: float = 0.5
    """Largest gain as a share of the stability bound."""


class SafeLearner(Learner):
    """Learner of monotone networks."""

    def __init__(self, cfg: Safe, grids: Sequence[Scenario]):
        for grid in grids:
            require_plain(grid)
        self.slopes = [cfg.margin * float(slope) for slope in np.min([slope_bounds(grid) for grid in grids], axis=0)]
        self.fields = field_names(grids[0])
        super().__init__(cfg, grids)

    def network(self, name: str, mean: torch.Tensor, std: torch.Tensor, n_out: int) -> torch.nn.Module:
        """Heads of an agent of this kind: clock and reactive power, or the latter alone."""
        fields = self.fields["dc_0" if name == "datacenter" else "inv_0"]
        n_own = len(fields)
        plates = [n_own, n_own + 1]  # draw and reach; the third figure of the nameplate holds the voltage
        inputs = [fields.index(field) for field in TARGET_FIELDS if field in fields] + plates
        reactive, clock = self.slopes
        if name == "datacenter":
            return Monotone(mean, std, [inputs, inputs], [clock, reactive], [True, False], self.cfg.hidden)
        return Monotone(mean, std, [inputs], [reactive], [False], self.cfg.hidden)


def require_plain(scenario: Scenario) -> None:
    """ValueError, naming them, for agents or channels for which no bound of the gain is known."""
    require_known_devices("safe training", scenario)
    for group in agent_groups(scenario).values():
        if group.channels != PLAIN_CHANNELS[group.kind]:
            raise ValueError(
                f"safe training bounds clocks and reactive power alone; on {scenario.name!r} agents of kind "
                f"{group.kind} have the channels {', '.join(group.channels)}: train analytic there"
            )


def main(cfg: Safe) -> Path:
    """Train; the folder written."""
    if cfg.view != "shared" or cfg.observe != "local":
        raise ValueError(f"view is {cfg.view!r} and observe {cfg.observe!r}; a safe policy is shared and local")
    if cfg.history:
        raise ValueError(f"history is {cfg.history}; the bound on the gain is that of a policy without one: give 0")
    return train(cfg, SafeLearner)
