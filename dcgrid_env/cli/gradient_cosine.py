"""The command ``dcgrid dev gradient-cosine``."""

from __future__ import annotations

from dataclasses import dataclass

from dcgrid_env.cli.command import Command
from dcgrid_env.cli.names import scenario_names
from dcgrid_env.cli.settings import at_least


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
    """Pairs of estimates, each with networks and episodes of its own."""
    gamma: float = 0.97
    """Discount of the team's return."""

    def run(self) -> None:
        """Print the table. ValueError for a setting that cannot be."""
        import numpy as np

        from dcgrid_env.agents.studies.gradient_agreement import agreement, require_served

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
