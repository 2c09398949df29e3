"""Run an entry: its processes, the scenario that it is scored on, and its figures next to the tuned droop's."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dcgrid_env import PRESETS, Scenario
from dcgrid_env.agents.leaderboard.entry_files import Figures, Score, SubmissionError
from dcgrid_env.agents.leaderboard.remote import remote
from dcgrid_env.agents.leaderboard.scopes import Scope
from dcgrid_env.agents.policy.unseen import on_purpose
from dcgrid_env.baselines import Controller, find_controller, published, rollout
from dcgrid_env.baselines.evaluation import Evaluation, evaluate
from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.baselines.score import REFERENCE, SPLIT, score, static_rules

TUNED = Path(str(files("dcgrid_env.baselines.data") / "tuned.json"))
"""Gains of tuned controllers: the bundled ones, independent of the working directory."""


class Runner(NamedTuple):
    """What is run of an entry."""

    spec: str
    """What names its controller, see ``find_controller``."""
    scope: Scope
    """What it is sent."""
    code: Path | None = None
    """The submitter's file, where it is code."""
    confined: bool = True
    """Whether that code is confined."""


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


def run(runner: Runner, scenario: Scenario, parts: Sequence[range], name: str) -> list[Run]:
    """Run an entry and the tuned droop through parts of the test split.

    All episodes are one batch in random order, so a position in the batch does not identify the episode.

    Parameters
    ----------
    runner
        What is run.
    scenario
        The preset on its test split.
    parts
        Seeds of each part, the last of them secret or none.
    name
        What errors call the entry.

    Raises
    ------
    ControllerError
        A ValueError, where the entry fails.
    """
    seeds = [seed for part in parts for seed in part]
    order = np.random.default_rng(seeds[-1]).permutation(len(seeds))
    code = None if runner.code is None else runner.code.read_bytes()
    with on_purpose(), remote(runner.spec, scenario, TUNED, runner.scope, code, runner.confined) as controller:
        recorder = rollout(scenario, controller, [seeds[i] for i in order], name=name)
    metrics = [recorder.series(int(env_index)).metrics() for env_index in np.argsort(order)]
    ends = np.cumsum([len(part) for part in parts])
    return [_run(scenario, part, metrics[end - len(part) : end]) for part, end in zip(parts, ends, strict=True)]


def _run(scenario: Scenario, seeds: range, metrics: Sequence[Mapping[str, float]]) -> Run:
    """Metrics of an entry on some episodes, and those of the tuned droop."""
    means = {key: float(np.mean([of_episode[key] for of_episode in metrics])) for key in metrics[0]}
    evaluation = Evaluation(scenario, tuple(seeds), np.array([of_episode["J"] for of_episode in metrics]), means)
    droop = _droop(scenario, tuple(seeds))
    gain = score(evaluation.J, droop.J, np.zeros(len(seeds))).score  # costs of 0 in hindsight's place: a share of J
    delays = evaluation.means["delay_mean_s"], droop.means["delay_mean_s"]
    figures = Figures(evaluation.means["J"], droop.means["J"], (gain.value, gain.low, gain.high), *delays)
    return Run(evaluation, droop, figures)


@lru_cache(maxsize=4)
def _droop(scenario: Scenario, seeds: tuple[int, ...]) -> Evaluation:
    return evaluate(controller_of(REFERENCE, scenario), scenario, seeds, REFERENCE)


def static_evaluations(scenario: Scenario, seeds: Sequence[int]) -> dict[str, Evaluation]:
    """Results of the rules without measurements that apply to a scenario and have tuned parameters, by name."""
    evaluations = {}
    for name in static_rules(scenario):
        with suppress(ValueError):
            evaluations[name] = evaluate(controller_of(name, scenario), scenario, seeds, name)
    return evaluations


def scored(run: Run) -> Score:
    """The score; ValueError where there is none, as where an episode is drawn otherwise here than it was published."""
    return Score(*run.evaluation.score(run.droop).score)


def reference(scenario: Scenario) -> str:
    """The controller of score 0 with its parameters, as a report names it."""
    return repr(controller_of(REFERENCE, scenario))


def episodes_hash(scenario: Scenario, episodes: int) -> str:
    """SHA-256 over hashes and published costs of the test episodes 0, 1, ..; SubmissionError beyond those."""
    costs = published(scenario)
    n = 0 if costs is None else len(costs.seeds)
    if costs is None or not 2 <= episodes <= n or costs.missing(range(episodes)):
        raise SubmissionError(f"episodes is {episodes}; {scenario.name} has {n} published ones, give 2 to {n}")
    costs = costs.of(range(episodes))
    return hashlib.sha256(f"{costs.episode_hashes}{costs.J.tolist()}".encode()).hexdigest()
