"""The agreement of two independent estimates of a policy gradient, for two ways to credit actions.

Both estimates use the same networks at the beginning of training, with separate episodes and exploration. Their cosine
is 1 if an estimate equals the gradient and about 0 if it is noise. There are two kinds of credit. The team's return is
the discounted cost from that step on, less its mean over the environments at that step; it is the same for all agents.
The counterfactual advantage differs for each agent's action (``training.counterfactual``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from stable_baselines3.common.utils import set_random_seed

from dcgrid_env.agents.algorithms.ppo_counterfactual import (
    CounterfactualPpo,
    PpoCounterfactual,
    Rollout,
    make,
    vec_env_for,
)
from dcgrid_env.agents.training.run_folder import torch
from dcgrid_env.agents.training.sb3 import episode_seed
from dcgrid_env.baselines.scenario_names import scenario_names
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.settings import at_least


class Agreement(NamedTuple):
    """Cosine between two estimates of the gradient."""

    team: float
    """By the team's return."""
    counterfactual: float
    """By counterfactual advantages."""


def require_served(scenarios: Sequence[str]) -> None:
    """ValueError for a preset that counterfactual advantages do not serve."""
    for scenario in scenarios:
        vec_env_for(PpoCounterfactual.for_scenario(scenario, num_envs=1))


def agreement(scenario: str, seed: int, num_envs: int, steps: int, gamma: float) -> Agreement:
    """The two cosines on a preset, over so many environments and steps for each estimate.

    ValueError for a scenario that counterfactual advantages do not serve.
    """
    cfg = PpoCounterfactual.for_scenario(scenario, seed=seed, num_envs=num_envs)
    vec_env = vec_env_for(cfg)
    model = make(cfg, vec_env)
    estimates = []
    for i in (1, 2):
        set_random_seed(2 * seed + i)
        vec_env.seed(episode_seed(seed, i, num_envs))
        model._last_obs = vec_env.reset()  # pyright: ignore[reportAttributeAccessIssue]
        data = model.rollout(min(steps, vec_env.scenario.horizon))
        by_team = team_advantages(data.costs, gamma)
        of_all = torch.as_tensor(by_team, dtype=torch.float32).reshape(-1, 1).expand_as(data.advantages)
        estimates.append([_gradient(model, data, credit) for credit in (of_all, data.advantages)])
    return Agreement(*(_cosine(*pair) for pair in zip(*estimates, strict=True)))


def team_advantages(costs: np.ndarray, gamma: float) -> np.ndarray:
    """Minus the discounted cost from each step on, less its mean over the environments, from costs (step, env)."""
    paid = np.zeros_like(costs)
    following = np.zeros(costs.shape[1])
    for t in reversed(range(len(costs))):
        paid[t] = following = costs[t] + gamma * following
    return paid.mean(axis=1, keepdims=True) - paid


def _gradient(model: CounterfactualPpo, data: Rollout, credit: torch.Tensor) -> np.ndarray:
    """Gradient of the loss by all weights, (n,)."""
    loss, _ = model.loss(data, model.normalised(credit), torch.arange(len(data.outputs)))
    by_weight = torch.autograd.grad(loss, list(model.policy.parameters()))
    return np.concatenate([each.cpu().numpy().ravel() for each in by_weight]).astype(np.float64)


def _cosine(a: np.ndarray, b: np.ndarray) -> float:
    return float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))


@dataclass(frozen=True)
class GradientCosine(Command):
    """Compare two estimates of PPO's gradient.

    One estimate uses the team's return, the other counterfactual advantages. Prints the table of
    docs/decisions/0014-counterfactual-advantages.md.
    """

    scenarios: str = "ieee33-weak,das69,khodr141,mixed,toy6"
    """Names of scenarios (dcgrid list), separated by commas."""
    num_envs: int = 24
    """Environments of each estimate."""
    steps: int = 40
    """Steps of each environment."""
    seeds: int = 5
    """Number of pairs of estimates, each with separate networks and episodes."""
    gamma: float = 0.97
    """Discount of the team's return."""

    def run(self) -> None:
        """Print the table. ValueError for an invalid setting."""
        if self.num_envs < 2:
            raise ValueError(
                f"num_envs is {self.num_envs}; give at least 2, as the team's return is measured from their mean"
            )
        at_least(self, steps=1, seeds=1)
        if not 0.0 < self.gamma <= 1.0:
            raise ValueError(f"gamma is {self.gamma}; give more than 0 and at most 1")
        scenarios = scenario_names(self.scenarios)
        require_served(scenarios)
        print("| scenario | the team's return | counterfactual advantage |\n|---|---|---|")
        for scenario in scenarios:
            found = [agreement(scenario, seed, self.num_envs, self.steps, self.gamma) for seed in range(self.seeds)]
            cells = (f"{np.mean(each):.3f} ({min(each):.3f} .. {max(each):.3f})" for each in zip(*found, strict=True))
            print(f"| `{scenario}` | {' | '.join(cells)} |", flush=True)
