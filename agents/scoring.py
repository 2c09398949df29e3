"""Score a policy in Python, next to the tuned droop and perfect foresight on the same episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env import METRICS, Scenario, make_scenario
from dcgrid_env.baselines import Controller, find_controller, published
from dcgrid_env.baselines.evaluation import Evaluation, evaluate, hindsight_costs
from dcgrid_env.baselines.hindsight_costs import FOLDER
from dcgrid_env.baselines.score import REFERENCE, SPLIT, Estimate

SHOWN = ("outside_bus_seconds_pct", "delay_mean_s")
"""Metrics in the text of a score, next to J."""


@dataclass(frozen=True)
class PolicyScore:
    """A policy's score, and the costs of the same episodes from which it follows."""

    name: str
    policy: Evaluation
    """Results of the policy; ``policy.means`` has all metrics."""
    droop: Evaluation
    """Results of the tuned droop."""
    J_hindsight: np.ndarray
    """Cost of each episode with perfect foresight, (n_episode,)."""
    is_best_known: bool
    """Whether ``J_hindsight`` are best known costs, which a policy may beat."""
    score: Estimate
    """Score with the ends of its 95 % interval over episodes: 0 is the tuned droop, 1 is ``J_hindsight``."""

    @property
    def J(self) -> np.ndarray:
        """Cost of each episode under the policy, (n_episode,)."""
        return self.policy.J

    @property
    def J_droop(self) -> np.ndarray:
        """Cost of each episode under the tuned droop, (n_episode,)."""
        return self.droop.J

    @property
    def violation_pct(self) -> float:
        """Share of bus-seconds outside the voltage band, per cent."""
        return self.policy.means["outside_bus_seconds_pct"]

    @property
    def delay_s(self) -> float:
        """Mean delay of work, s."""
        return self.policy.means["delay_mean_s"]

    def __str__(self) -> str:
        """Return a table of means over the episodes."""
        scenario, metrics = self.policy.scenario, [METRICS[name] for name in SHOWN]
        title = f"{scenario.name}, {scenario.split} split, {len(self.policy.seeds)} episodes"
        rows = [(title, "J", *(metric.heading for metric in metrics))]
        for name, each in ((self.name, self.policy), (REFERENCE, self.droop)):
            rows.append((name, f"{each.J.mean():.4f}", *(metric.text(each.means[metric.name]) for metric in metrics)))
        bound = "best known" if self.is_best_known else "hindsight"
        rows.append((bound, f"{self.J_hindsight.mean():.4f}", *("" for _ in metrics)))
        first, *widths = (max(map(len, column)) for column in zip(*rows, strict=True))
        lines = ["  ".join([label.ljust(first), *map(str.rjust, figures, widths)]).rstrip() for label, *figures in rows]
        value, low, high = (round(end, 3) + 0.0 for end in self.score)  # 0.0 also for -0.0
        return "\n".join([*lines, f"score {value:.3f} (95 % interval {low:.3f} to {high:.3f})"])


def score(
    policy: Any, scenario: str | Scenario, seeds: Sequence[int] = range(32), *, split: str = SPLIT
) -> PolicyScore:
    """Run a policy and the tuned droop through the same episodes, and score the policy.

    Parameters
    ----------
    policy
        A model of Stable-Baselines3 in memory, with the VecNormalize around its environment; a ``Policy``, a
        ``RowPolicy`` or another controller; or a name or path as in ``dcgrid evaluate``.
    scenario
        Name of a preset, or a Scenario.
    seeds
        Seeds of the episodes, at least two different ones.
    split
        Split of the episodes.

    Returns
    -------
    PolicyScore
        ``score`` with its interval, costs ``J``, ``J_droop`` and ``J_hindsight`` of each episode, ``violation_pct`` and
        ``delay_s``. Its text is a table.

    Raises
    ------
    ValueError
        If there are no hindsight costs of these episodes, a seed is repeated, the droop has no tuned gains, or the
        policy does not fit the scenario.
    TypeError
        If ``policy`` is none of these, or ``seeds`` is no sequence.

    Examples
    --------
    >>> import dcgrid_env
    >>> result = dcgrid_env.score("constant-q-tuned", "toy6", seeds=range(4))
    >>> result.J.shape
    (4,)
    """
    _check_seeds(seeds)
    on = make_scenario(scenario, split=split)
    hindsight = published(on, FOLDER)
    costs = hindsight_costs(on, seeds, hindsight)
    controller = _controller(policy, on)
    name = str(policy) if isinstance(policy, str | Path) else type(policy).__name__
    driven, droop = evaluate(controller, on, seeds, name), evaluate(find_controller(REFERENCE, on), on, seeds)
    is_best_known = hindsight is not None and hindsight.is_best_known
    return PolicyScore(name, driven, droop, costs, is_best_known, driven.score(droop, hindsight).score)


def _check_seeds(seeds: Sequence[int]) -> None:
    """Raise TypeError or ValueError unless there are at least two seeds, each once."""
    if not isinstance(seeds, Sequence | np.ndarray) or isinstance(seeds, str):
        raise TypeError(f"seeds is {seeds!r}; give a sequence of seeds, such as range(32)")
    if len(seeds) < 2:
        raise ValueError(f"seeds has the length {len(seeds)}; an interval takes at least 2 episodes")
    if len(set(seeds)) < len(seeds):
        raise ValueError("seeds has a seed twice, which narrows the interval without further episodes; give each once")


def _controller(policy: Any, scenario: Scenario) -> Controller:
    """Return the controller that a user gives in any form; raise TypeError for another object."""
    if isinstance(policy, str | Path):
        return find_controller(str(policy), scenario)
    if hasattr(policy, "get_vec_normalize_env") and not isinstance(policy, type):
        from dcgrid_env.agents.from_sb3.sb3_controller import of_model

        return of_model(policy)
    if not isinstance(policy, Controller) or isinstance(policy, type):
        raise TypeError(
            f"policy is of type {type(policy).__name__}; give a model of Stable-Baselines3, a controller with reset "
            "and act, a name or path, or RowPolicy(function) for a function of rows"
        )
    return policy
