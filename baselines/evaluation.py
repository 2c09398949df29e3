"""Evaluate a controller or a policy on episodes of a scenario, and score it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from dcgrid_env import METRICS, Scenario
from dcgrid_env.baselines import Controller, Published, published, rollout
from dcgrid_env.baselines.controller import with_figures
from dcgrid_env.baselines.score import IS_NO_BOUND, REFERENCE, STATIC, Score, saved_pct, score

_checked: WeakKeyDictionary[Scenario, set[tuple[str, ...]]] = WeakKeyDictionary()
"""Hashes of episodes that have been verified, so that many policies on the same episodes need only one check."""


@dataclass(frozen=True)
class Evaluation:
    """Results of a controller on some episodes of a scenario."""

    scenario: Scenario
    seeds: tuple[int, ...]
    J: np.ndarray
    """Cost of each episode, (n_episode,), in the order of the seeds."""
    means: Mapping[str, float]
    """Mean over the episodes of each metric, and of the controller's figures (``controller.ReportsFigures``)."""

    def score(self, droop: Evaluation, hindsight: Published | None = None) -> Score:
        """Score against the tuned droop on the same episodes, and hindsight's costs of them.

        Parameters
        ----------
        droop
            Results of the tuned droop on the same episodes.
        hindsight
            Costs of perfect foresight, ``published(scenario, folder)``; the bundled ones by default.

        Raises
        ------
        ValueError
            If a score cannot be computed. The episodes differ, hindsight is missing for exactly this scenario, split
            and seeds, or its episodes were drawn differently.
        """
        if droop.seeds != self.seeds or droop.scenario != self.scenario:
            raise ValueError("no score: the droop was run on other episodes; evaluate both on the same")
        if len(self.seeds) < 2:
            raise ValueError("no score: an interval takes at least 2 episodes")
        return score(self.J, droop.J, hindsight_costs(self.scenario, self.seeds, hindsight))


def hindsight_costs(scenario: Scenario, seeds: Sequence[int], hindsight: Published | None = None) -> np.ndarray:
    """Return the hindsight costs of these episodes, (n_episode,), after checking that the episodes are the same here.

    See :meth:`Evaluation.score` for ``hindsight`` and ValueError.
    """
    hindsight = hindsight or published(scenario)
    if hindsight is None:
        raise ValueError(
            f"no score: hindsight is published for the test split of the presets as they are, not for this "
            f"{scenario.name} ({scenario.split} split)"
        )
    if missing := hindsight.missing(seeds):
        n = len(hindsight.seeds)
        raise ValueError(f"no score: hindsight is published for {n} episodes, not for seed {missing[0]}")
    bundled = hindsight.select(seeds)
    if bundled.episode_hashes not in _checked.get(scenario, ()):
        bundled.check_episodes(scenario, len(seeds))
        _checked.setdefault(scenario, set()).add(bundled.episode_hashes)
    return bundled.J


def evaluate(controller: Controller, scenario: Scenario, seeds: Sequence[int], name: str | None = None) -> Evaluation:
    """Run a policy or any other controller through the episodes of these seeds.

    Parameters
    ----------
    controller
        Controller of the agents; a policy receives the scope of observation that it was trained with.
    scenario
        Scenario to run; its split determines the episode of each seed.
    seeds
        Seeds of the episodes, which run as one batch.
    name
        Name of the controller in errors; its class by default.

    Raises
    ------
    ControllerError
        A ValueError, if the controller fails or cannot drive the scenario; the message names the difference.
    """
    recorder = rollout(scenario, controller, seeds, name=name)
    metrics = with_figures(controller, recorder.metrics())
    means = {name: float(np.mean([m[name] for m in metrics])) for name in metrics[0]}
    return Evaluation(scenario, tuple(seeds), np.array([m["J"] for m in metrics]), means)


def below_static(name: str, means: Mapping[str, float], rules: Mapping[str, Evaluation]) -> str | None:
    """Return a warning if a rule that uses no measurements has a lower cost than a controller; None if not.

    Parameters
    ----------
    name
        Name of the controller; no warning is for one of the rules (``score.STATIC``).
    means
        Its mean metrics.
    rules
        Results of controllers on the same episodes, by name; others than these rules are ignored.
    """
    of_rules = {rule: rules[rule].means for rule in STATIC if rule in rules}
    if not of_rules or name in STATIC:
        return None
    j, best = METRICS["J"], min(of_rules, key=lambda rule: of_rules[rule]["J"])
    if not j.is_worse(means, of_rules[best]):
        return None
    worse = f"J {j.text(means['J'])} is higher than {j.text(of_rules[best]['J'])} of {best}"
    return f"{name}: {worse}, which uses no measurements"


def headroom_lines(costs: Published, j_reference: ArrayLike) -> list[str]:
    """Return lines with the headroom, and a note that the best known cost is not a bound."""
    name = "the best known" if costs.is_best_known else "hindsight"
    line = f"headroom: {name} saves {saved_pct(costs.J, j_reference):.1f} % of the J of {REFERENCE}"
    return [line, IS_NO_BOUND] if costs.is_best_known else [line]


def episode_records(
    scenario: str, controller: str, seeds: Sequence[int], metrics: Sequence[Mapping[str, float]], first: int = 0
) -> list[dict[str, Any]]:
    """Return a record for each episode, as results.json contains them; ``first`` is the number of the first."""
    return [
        {"scenario": scenario, "controller": controller, "episode": first + i, "seed": seed, **figures}
        for i, (seed, figures) in enumerate(zip(seeds, metrics, strict=True))
    ]
