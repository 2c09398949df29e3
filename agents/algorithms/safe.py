"""A safe policy: monotone in the own voltage, its gain below the linear stability bound whatever it learns.

The networks are those of ``monotone``, trained as ``analytic`` trains. The bounds on their slopes come from the feeder
before training (``bounds``), with X and R in bands per share of the agents' ratings, d the data centres, and m the age
of the measurement in steps:

    reactive power    slope lambda_max(D^1/2 X D^1/2) = margin 2 sin(pi / (2 (2 m + 1)))     the integrating droop's
    clock             slope rho(R_dd) = margin / 2        the proportional droop's, whose backlog is served at once

The second is that of ``baselines.stability`` with alpha dt = 1: what the clock held back is asked for again a step
later. The first with m steps of delay is where a root of z^(m+1) - z^m + k leaves the unit circle. Each holds for its
axis alone; both together move a voltage that both see, and the margin must leave room for that. They are of the
linearised feeder, see ``baselines.stability`` for what that leaves out, and of the feeder that was trained on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dcgrid_env import Feeder, RandomFeeders, Scenario, field_names, sensitivity_between_agents
from dcgrid_env.agents.algorithms.analytic import Analytic, Learner
from dcgrid_env.agents.algorithms.analytic import main as train
from dcgrid_env.agents.policy.agent_groups import PLAIN_CHANNELS, agent_groups
from dcgrid_env.agents.training.run_folder import torch
from dcgrid_env.agents.training.torch_modules import Monotone
from dcgrid_env.baselines.controller import require_known_devices
from dcgrid_env.baselines.laws.stability import placements

TARGET_FIELDS = ("r", "x", "p_ref_next")
"""What moves the voltage that is aimed at: where the agent stands, and what its site is about to draw. Nothing here
depends on what the policy does, or it would be a second loop without a bound."""
PLACEMENTS = 1000
"""Seeds whose placements are looked at where a scenario draws them."""


@dataclass(frozen=True)
class Safe(Analytic):
    """Train a policy by gradients through the grid that is monotone and of bounded gain."""

    margin: float = 0.5
    """Largest gain as a share of the stability bound."""


def bounds(scenario: Scenario) -> tuple[float, float]:
    """Largest stable slope of reactive power and of the clock, in units of the action for each band of voltage.

    The smallest over ``PLACEMENTS`` placements that the scenario draws; infinite where there are no agents of the kind.
    """
    if isinstance(scenario.feeder, RandomFeeders):
        raise ValueError(
            f"safe: the bound on gains is that of one feeder, and {scenario.name} has random ones; train analytic, or "
            "give another feeder"
        )
    index, n_dc = scenario.feeder.index, scenario.n_datacenters
    largest = _eigenvalue if isinstance(scenario.feeder, Feeder) else _singular_value
    q_mvar = scenario.q_scale_kvar / 1e3
    # Half the range of actions moves half the power between the slowest clock and the top.
    p_mw = 0.5 * (1.0 - scenario.f_min_mhz / scenario.f_max_mhz) * scenario.datacenter.p_dynamic_kw / 1e3
    late = np.sin(np.pi / (2 * (2 * scenario.measurement_delay + 1)))
    slopes = []
    for buses in placements(scenario, PLACEMENTS):
        at = np.array([[index(bus) for bus in buses]])
        r, x = (by[0] / (scenario.band_pu or 1.0) for by in sensitivity_between_agents(scenario, at))
        x_scaled = np.sqrt(q_mvar)[:, None] * x * np.sqrt(q_mvar)
        r_scaled = np.sqrt(p_mw)[:, None] * r[:n_dc, :n_dc] * np.sqrt(p_mw)
        of_clock = 0.5 / largest(r_scaled) if n_dc else np.inf
        slopes.append((2.0 * late / largest(x_scaled), of_clock))
    reactive, clock = np.min(slopes, axis=0)
    return float(reactive), float(clock)


def _eigenvalue(matrix: np.ndarray) -> float:
    """Largest eigenvalue of a balanced feeder's sensitivities, which are symmetric."""
    return np.linalg.eigvalsh(matrix)[-1]


def _singular_value(matrix: np.ndarray) -> float:
    """Largest singular value, no less than any eigenvalue: a three-phase feeder's sensitivities are not symmetric."""
    return float(np.linalg.norm(matrix, 2))


class SafeLearner(Learner):
    """Learner of monotone networks."""

    def __init__(self, cfg: Safe, grids: Sequence[Scenario]):
        for grid in grids:
            require_plain(grid)
        self.slopes = [cfg.margin * float(slope) for slope in np.min([bounds(grid) for grid in grids], axis=0)]
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
    if not 0.0 < cfg.margin < 1.0:
        raise ValueError(f"margin is {cfg.margin}; give more than 0 and less than 1")
    return train(cfg, SafeLearner)
