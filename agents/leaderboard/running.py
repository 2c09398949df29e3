"""Running an entry: its controller, the scenario it is scored on, and its figures beside the tuned droop's."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env import PRESETS, Scenario
from dcgrid_env.agents.leaderboard.entry_files import Figures, Score, SubmissionError
from dcgrid_env.agents.policy.guard import GuardedPolicy
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.policy.trial_guard import TriedPolicy
from dcgrid_env.agents.policy.unseen import on_purpose
from dcgrid_env.baselines import Controller, find_controller, published
from dcgrid_env.baselines.benchmark.jobs import observed
from dcgrid_env.baselines.evaluation import Evaluation, evaluate
from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.baselines.score import REFERENCE, SPLIT, score

TUNED = Path(str(files("dcgrid_env.baselines.data") / "tuned.json"))
"""Gains of tuned controllers: those that ship, whatever stands in the working directory."""


class Run(NamedTuple):
    """A controller on episodes of a preset's test split."""

    evaluation: Evaluation
    droop: Evaluation
    figures: Figures


def scenario_of(name: str) -> Scenario:
    """A preset on its test split; SubmissionError for another name."""
    if name not in PRESETS:
        raise SubmissionError(f"scenario is {name!r}; the leaderboard is over the presets: {', '.join(PRESETS)}")
    return ScenarioSpec(name).make(SPLIT)


def controller_of(spec: str, scenario: Scenario) -> Controller:
    """A fresh controller with the gains that ship; ValueError for what names none."""
    return find_controller(spec, scenario, TUNED)


def shown(controller: Controller, scenario: Scenario) -> str:
    """What a controller's interface is shown: ``local``, where each agent has its own measurements and no more."""
    inner: Any = controller.policy if isinstance(controller, GuardedPolicy | TriedPolicy) else controller
    words = observed(inner, scenario)
    return f"{words}, of all agents together" if isinstance(inner, Policy) and inner.kind == "joint" else words


def run(controller: Controller, scenario: Scenario, seeds: Sequence[int], name: str) -> Run:
    """Run a controller and the tuned droop through episodes; ControllerError, a ValueError, where it fails."""
    with on_purpose():
        own = evaluate(controller, scenario, seeds, name)
    droop = _droop(scenario, tuple(seeds))
    gain = score(own.J, droop.J, np.zeros(len(seeds))).score  # with a cost of 0 in hindsight's place, a share of J
    delays = own.means["delay_mean_s"], droop.means["delay_mean_s"]
    return Run(own, droop, Figures(own.means["J"], droop.means["J"], (gain.value, gain.low, gain.high), *delays))


@lru_cache(maxsize=4)
def _droop(scenario: Scenario, seeds: tuple[int, ...]) -> Evaluation:
    return evaluate(controller_of(REFERENCE, scenario), scenario, seeds, REFERENCE)


def scored(run: Run) -> Score:
    """The score; ValueError where there is none, as where an episode is drawn otherwise here than it was published."""
    return Score(*run.evaluation.score(run.droop).score)


def episodes_hash(scenario: Scenario, episodes: int) -> str:
    """SHA-256 over the hashes of the published test episodes 0, 1, ..; SubmissionError beyond those."""
    costs = published(scenario)
    n = 0 if costs is None else len(costs.seeds)
    if costs is None or not 2 <= episodes <= n or costs.missing(range(episodes)):
        raise SubmissionError(f"episodes is {episodes}; {scenario.name} has {n} published ones, give 2 to {n}")
    return hashlib.sha256(" ".join(costs.of(range(episodes)).episode_hashes).encode()).hexdigest()
