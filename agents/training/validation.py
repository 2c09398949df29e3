"""Validation during training: a policy's cost on the validation split, compared with the tuned droop law."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

import numpy as np

from dcgrid_env import Scenario, make_scenario
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.baselines import make_controller, rollout
from dcgrid_env.core.versions import command_words

_KEPT = ("J", "delay_mean_s", "excess_mean_pu", "cost_violation", "cost_backlog", "cost_leftover")


class Validation:
    """Judges policies on the validation split, against the tuned droop law on the same episodes.

    Parameters
    ----------
    scenarios
        Presets by name, or scenarios on the validation split; figures are means over them.
    episodes
        Seeds 0, 1, .. of each.
    """

    def __init__(self, scenarios: Sequence[str | Scenario], episodes: int):
        self.scenarios = [make_scenario(s, split="validation") if isinstance(s, str) else s for s in scenarios]
        self.seeds = range(episodes)
        self.j_droop = self._mean([self._run(s, make_controller("droop-tuned", s)) for s in self.scenarios])["J"]

    def __call__(self, policy: Policy) -> dict[str, float]:
        """Means: J, its parts for waiting and for violation, and the tuned droop's J.

        Also the share by which J is below that, the delay, s, and the excess over the band, p.u.
        """
        figures = self._mean([self._run(scenario, policy) for scenario in self.scenarios])
        return figures | {"J_droop": self.j_droop, "gain": 1.0 - figures["J"] / self.j_droop}

    def _run(self, scenario: Scenario, controller: object) -> list[dict[str, float]]:
        metrics_by_episode = rollout(scenario, controller, self.seeds).metrics()  # pyright: ignore[reportArgumentType]
        weight = scenario.cost.weights.violation or 1.0
        return [metrics | {"excess_mean_pu": metrics["cost_violation"] / weight} for metrics in metrics_by_episode]

    @staticmethod
    def _mean(runs: list[list[dict[str, float]]]) -> dict[str, float]:
        every = [metrics for run in runs for metrics in run]
        mean = {name: float(np.mean([m[name] for m in every])) for name in every[0] if name in _KEPT}
        return mean | {
            "J_waiting": mean.pop("cost_backlog") + mean.pop("cost_leftover"),
            "J_violation": mean.pop("cost_violation"),
        }


def made_with() -> str:
    """The command that runs, without options that do not affect the policy."""
    free = ("--resume", "--no-resume", "--traceback")
    given, words = iter(command_words()), []
    for word in given:
        if word == "--out":
            next(given, None)
        elif word not in free and not word.startswith("--out="):
            words.append(word)
    return shlex.join(words)


def stepped(scenarios: Sequence[Scenario], num_envs: int, iterations: int) -> dict[str, float]:
    """Steps of environments in so many iterations, each a batch of episodes on one of the scenarios in turn."""
    return {"env_steps": float(num_envs * sum(scenarios[k % len(scenarios)].horizon for k in range(iterations)))}
