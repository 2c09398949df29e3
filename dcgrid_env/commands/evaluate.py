"""Score a policy on held-out episodes, beside the tuned droop law and the best rules that measure nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

if TYPE_CHECKING:
    from dcgrid_env.agents import Evaluation
    from dcgrid_env.baselines.score import Estimate
    from dcgrid_env.benchmark.tables import Table


@dataclass(frozen=True)
class Evaluate:
    """What to evaluate."""

    policy: tyro.conf.Positional[str]
    """A policy that ships or a controller (dcgrid list), a training run's folder, a policy's file, or a class of your
    own (module:Class, file.py:Class)."""
    scenario: str | None = None
    """Name of a scenario; the one that the policy was trained on unless given."""
    split: str = "test"
    """Which episodes the seeds mean: train, validation, test or ood. Scores are of the test split."""
    episodes: int = 100
    """Episodes: those of seeds 0, 1, ..."""


ROWS = (
    ("J", "J", 4),
    ("mean |V-1|, p.u.", "voltage_deviation_mean_pu", 4),
    ("bus-seconds outside, %", "outside_bus_seconds_pct", 2),
    ("mean delay, s", "delay_mean_s", 2),
    ("99 % of work within, s", "delay_p99_s", 1),
    ("unserved at the end, kW s", "unserved_kws", 1),
    ("effort, % of rating", "q_effort_pct", 1),
)
"""Rows of the table: name with unit, metric, decimals."""


def main(cfg: Evaluate) -> None:
    """Run, print the table and what it says. ValueError for a setting that cannot be."""
    from rich.console import Console

    from dcgrid_env import make_scenario
    from dcgrid_env.agents import evaluate, find_controller
    from dcgrid_env.agents.evaluate import REFERENCE, STATIC

    if cfg.episodes < 1:
        raise ValueError(f"episodes is {cfg.episodes}; give at least 1")
    spec = _spec(cfg.policy)
    scenario = make_scenario(cfg.scenario or _trained_on(spec), split=cfg.split)
    seeds = range(cfg.episodes)
    console = Console()
    found = {}
    with console.status(f"{cfg.episodes} episodes of {scenario.name}"):
        for name in dict.fromkeys((cfg.policy, REFERENCE, *STATIC)):
            controller = find_controller(spec if name == cfg.policy else name, scenario)
            found[name] = evaluate(controller, scenario, seeds)
    scores, why = _scores(found, found[REFERENCE])
    made = table(found, scores, f"{scenario.name}, {cfg.split} split, {cfg.episodes} episodes")
    console.print(made.rich(console.width))
    for line in [*([why] if why else []), *remarks(cfg.policy, found)]:
        console.print(line, highlight=False, markup=False)


def _spec(policy: str) -> str:
    """The policy's file where a training run's folder is named."""
    return str(Path(policy) / "policy.safetensors") if Path(policy).is_dir() else policy


def _trained_on(spec: str) -> str:
    from dcgrid_env import PRESETS
    from dcgrid_env.agents.policy import SHIPPED, SUFFIX, Policy

    scenario = Policy.load(spec).trained_on if spec in SHIPPED or spec.endswith(SUFFIX) else ""
    if scenario not in PRESETS:
        raise ValueError(f"policy {spec!r} is of no preset of its own; say on which --scenario (dcgrid list)")
    return scenario


def _scores(found: Mapping[str, Evaluation], droop: Evaluation) -> tuple[dict[str, Estimate], str | None]:
    """Scores by controller, or why there are none."""
    try:
        return {name: evaluation.score(droop).score for name, evaluation in found.items()}, None
    except ValueError as error:
        return {}, str(error)


def table(found: Mapping[str, Evaluation], scores: Mapping[str, Estimate], title: str) -> Table:
    """The controllers side by side."""
    from dcgrid_env.benchmark.tables import Table

    rows = []
    if scores:
        for i, label in enumerate(("score", "95 % interval: from", "to")):
            rows.append((label, *(f"{scores[name][i]:.3f}" for name in found)))
    for label, key, decimals in ROWS:
        rows.append((label, *(f"{found[name].means[key]:.{decimals}f}" for name in found)))
    return Table(title, ("mean over episodes", *found), tuple(rows))


def remarks(policy: str, found: Mapping[str, Evaluation]) -> list[str]:
    """What must not be overlooked: delay that pays for voltage, and rules that measure nothing and do better."""
    from dcgrid_env.agents.evaluate import REFERENCE, STATIC

    said, own, droop = [], found[policy].means, found[REFERENCE].means
    if round(own["delay_mean_s"], 2) > round(droop["delay_mean_s"], 2):
        said.append(
            f"{policy}: work waits longer than under the tuned droop: mean delay {own['delay_mean_s']:.2f} s, there "
            f"{droop['delay_mean_s']:.2f} s"
        )
    best = min(STATIC, key=lambda name: found[name].means["J"])
    if policy not in STATIC and round(own["J"], 4) > round(found[best].means["J"], 4):
        said.append(
            f"{policy}: J {own['J']:.4f} is above that of {best}, {found[best].means['J']:.4f}, which measures nothing"
        )
    return said
