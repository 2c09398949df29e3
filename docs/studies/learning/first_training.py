"""Train PPO by the lines of the README on every preset, and print which environment teaches what, and how fast."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import dcgrid_env
from dcgrid_env import make_scenario, scenario_hash
from dcgrid_env.agents import ppo_settings, sb3_vec_env
from dcgrid_env.baselines.evaluation import hindsight_costs
from dcgrid_env.baselines.scenario_names import scenario_names
from dcgrid_env.baselines.score import score
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.settings import at_least, check_file
from dcgrid_env.core.files import write_json
from dcgrid_env.core.user_files import read_json
from docs.studies.learning.scored import droop_on_test, on_test

DATA, EPISODES = Path("docs/first-training.json"), 32
TEACHES = {
    "toy6": "a check: one site, one step of load",
    "ieee123": "reactive power alone; nearly constant",
    "ieee33-weak": "clock against voltage on a weak feeder",
    "ieee33": "where an inverter is matters",
    "das69": "long laterals; little to gain",
    "khodr141": "large sites in a city; reactive power",
    "bursty": "bursts of ten seconds: waiting against voltage",
    "sync": "sites that ramp together",
    "training": "swings of training jobs, steps of 0.1 s",
    "mixed": "reactive power that follows clouds",
    "fault": "equipment that is lost within the episode",
    "robust": "wrong model, noise and delay",
    "wrong-model": "a wrong model and bursts",
    "late-measurements": "voltages that are 5 s old",
    "scale-32": "32 sites with one policy",
    "ieee13-3ph": "regulators that act: taps cost",
    "ieee34-3ph": "a long feeder with regulators",
    "ieee123-3ph": "the paper's study with three phases; little to gain",
    "ieee13-3ph-published": "published set points: make relays tap",
    "ieee34-3ph-published": "published set points on a long feeder",
    "ieee123-3ph-published": "published set points, ten regulators",
    "ieee123-3ph-day": "set points of regulators and banks over a day",
    "ride-through": "when to return after a sag",
    "ieee33-weak-ups": "storage of the sites",
    "smoothing": "settings of GPU power smoothing",
    "routing": "where to compute, with deadlines",
    "load-target": "a utility's cap for all sites",
    "zero-shot": "feeders that no policy has seen",
}
"""What each preset teaches, in the order of the table."""
STEPS = {
    "scale-32": 20_000, "ieee13-3ph": 30_000, "ieee13-3ph-published": 30_000, "ieee123-3ph-day": 30_000,
    "ride-through": 40_000, "smoothing": 384_000,
}  # fmt: skip
"""Steps of all environments together; 60,000 on the others."""
NUM_ENVS = {"scale-32": 16, "smoothing": 16}
"""Environments of the batch; 32 on the others, and 64 in trainings of 200,000 steps or more."""


def trained(scenario: str, seed: int, steps: int) -> dict[str, Any]:
    """Train by the lines of the README, and return the record of the last model on the test episodes."""
    import torch
    from stable_baselines3 import PPO

    torch.set_num_threads(1)
    began_s = time.process_time()
    envs = sb3_vec_env(scenario, NUM_ENVS.get(scenario, 32 if steps < 200_000 else 64))
    model = PPO(env=envs, **ppo_settings(envs, steps), seed=seed)
    model.learn(steps * envs.rows_per_env // envs.rows.action_repeat)
    cpu_s = time.process_time() - began_s
    j = dcgrid_env.score(model, scenario, range(EPISODES)).J
    return {
        "scenario": scenario, "seed": seed, "steps": steps, "scenario_hash": scenario_hash(on_test(scenario)),
        "cpu_s": round(cpu_s, 1), "J": [round(cost, 6) for cost in j.tolist()],
    }  # fmt: skip


def table(records: Sequence[dict[str, Any]]) -> str:
    """Return a row for each preset and number of steps, as Markdown."""
    lines = [
        "| scenario | what it teaches | agents | headroom, % | steps | CPU, s | seeds | score: median (range) |",
        "|" + "---|" * 8,
    ]
    for name, teaches in TEACHES.items():
        droop, best = droop_on_test(name, EPISODES).J, hindsight_costs(on_test(name), range(EPISODES))
        headroom = 100.0 * (1.0 - best.mean() / droop.mean())
        for steps in sorted({record["steps"] for record in records if record["scenario"] == name}):
            group = [record for record in records if (record["scenario"], record["steps"]) == (name, steps)]
            scores = [score(record["J"], droop, best).score.value for record in group]
            cpu_s = float(np.median([record["cpu_s"] for record in group]))
            spread = f" ({min(scores):.2f} to {max(scores):.2f})" if len(scores) > 1 else ""
            lines.append(
                f"| `{name}` | {teaches} | {make_scenario(name).n_agents} | {headroom:.1f} | {steps:,} | {cpu_s:.0f} | "
                f"{len(group)} | {np.median(scores):.2f}{spread} |"
            )
    return "\n".join(lines)


@dataclass(frozen=True)
class FirstTraining(Command):
    """Train PPO by the README's lines on presets.

    Prints what it reaches. Each training is added to the file. Finished trainings are skipped.
    """

    scenarios: str = ""
    """Names of scenarios (dcgrid list), separated by commas; none by default, which prints the table of the file."""
    seeds: int = 5
    """Number of training seeds: 0, 1, .."""
    steps: int | None = None
    """Steps of all environments together; by default those of the table."""
    out: Path = DATA
    """File of the trainings."""

    def run(self) -> None:
        """Train and print. ValueError for an invalid setting."""
        at_least(self, seeds=1)
        if self.steps is not None:
            at_least(self, steps=1)
        check_file("out", self.out)
        records = read_json(self.out, ValueError, "choose another --out")["trainings"] if self.out.exists() else []
        for seed in range(self.seeds):
            for name in scenario_names(self.scenarios) if self.scenarios else ():
                steps = self.steps or STEPS.get(name, 60_000)
                if not any((one["scenario"], one["seed"], one["steps"]) == (name, seed, steps) for one in records):
                    records.append(trained(name, seed, steps))
                    write_json(self.out, {"trainings": records})
        print(table(records))
