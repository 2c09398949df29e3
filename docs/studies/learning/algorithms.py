"""Tables and performance profiles of standard algorithms on seven tasks, from trainings of ``libraries``.

The interquartile mean, its interval by a stratified bootstrap and the performance profiles are those of the package
rliable: R. Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice", NeurIPS 2021.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import trim_mean

from dcgrid_env.baselines.evaluation import hindsight_costs
from dcgrid_env.baselines.score import Estimate
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.settings import check_file
from dcgrid_env.core.figure_axes import label_axes, new_figure
from dcgrid_env.core.files import write_figure
from docs.studies.learning.learning_tables import NONE, estimate
from docs.studies.learning.libraries import records_in
from docs.studies.learning.scored import droop_on_test, on_test

DATA, FIGURE = Path("docs/algorithms.json"), Path("docs/images/algorithms.png")
TASKS = ("ieee33-weak", "mixed", "late-measurements", "wrong-model", "routing", "ride-through", "smoothing")
COMPARED = TASKS[:-1]
"""Tasks of the figures over tasks: only PPO was trained on the last one."""
NAMES = {
    "sb3-ppo": "PPO",
    "benchmarl-ippo": "IPPO",
    "benchmarl-mappo": "MAPPO",
    "sb3-sac": "SAC",
    "sb3-td3": "TD3",
    "benchmarl-maddpg": "MADDPG",
}
"""Algorithms by the key of their library, in the order of the tables."""
COLOURS = dict(zip(NAMES.values(), ("#0072B2", "#56B4E9", "#009E73", "#D55E00", "#CC79A7", "#E69F00"), strict=True))
OF_AGENTS = "difference"
"""Name in the tables of the reward that pays agents: difference, or local where that is not defined."""
TRIMMED, RESAMPLES, LEVEL = 0.25, 10_000, 0.95
LOWEST, HIGHEST = -1.0, 1.0
"""Scores that the profiles are drawn between."""


class Runs:
    """Trainings of an algorithm with one kind of reward.

    Parameters
    ----------
    records
        At least one, as ``libraries`` has them.
    """

    def __init__(self, records: Sequence[dict[str, Any]]):
        self.records = records
        by_task = {task: [one for one in records if one["scenario"] == task] for task in TASKS}
        self.scores = {task: [run_score(one) for one in each] for task, each in by_task.items() if each}
        """Score of each training seed, for each task."""

    def mean_of(self, field: str) -> float:
        """Return the mean of a field over the compared tasks: that of each task's mean."""
        values = [[one[field] for one in self.records if one["scenario"] == task] for task in COMPARED]
        return float(np.mean([np.mean(each) for each in values if each]))

    @property
    def matrix(self) -> np.ndarray:
        """Scores on the compared tasks, of as many seeds as each of these has, (seed, task)."""
        compared = [scores for task, scores in self.scores.items() if task in COMPARED]
        return np.array([scores[: min(map(len, compared))] for scores in compared]).T


def run_score(record: dict[str, Any]) -> float:
    """Return the score of one training over its test episodes."""
    scenario, episodes = record["scenario"], record["episodes"]
    droop, best = droop_on_test(scenario, episodes).J, hindsight_costs(on_test(scenario), range(episodes))
    return float(np.mean(droop - record["J"]) / np.mean(droop - best))


def interquartile_mean(scores: np.ndarray, seed: int = 0) -> Estimate:
    """Compute the mean of the middle half of all scores, (seed, task), and its stratified bootstrap interval.

    Seeds are drawn again within each task, so the interval is for other seeds of the same tasks. With one seed there is
    none, and its ends are not a number.
    """
    value = float(trim_mean(scores.ravel(), TRIMMED))
    n_seed, n_task = scores.shape
    if n_seed == 1:
        return Estimate(value, np.nan, np.nan)
    drawn = np.random.default_rng(seed).integers(n_seed, size=(RESAMPLES, n_seed, n_task))
    resampled = scores[drawn, np.arange(n_task)].reshape(RESAMPLES, -1)
    low, high = np.quantile(trim_mean(resampled, TRIMMED, axis=1), [0.5 - LEVEL / 2, 0.5 + LEVEL / 2])
    return Estimate(value, float(low), float(high))


def profile(scores: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """Return the share of runs, (seed, task), with a score above each threshold, (threshold,)."""
    return (scores.reshape(-1, 1) > thresholds).mean(axis=0)


def runs_by_reward(records: Sequence[dict[str, Any]]) -> dict[tuple[str, str], Runs]:
    """Return the trainings of each reward and algorithm, in the order of the tables."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for record in sorted(records, key=lambda one: one["seed"]):
        reward = "shared" if record["reward"] == "shared" else OF_AGENTS
        groups.setdefault((reward, NAMES[record["library"]]), []).append(record)
    order = [(reward, name) for reward in (OF_AGENTS, "shared") for name in NAMES.values()]
    return {key: Runs(groups[key]) for key in order if key in groups}


def tables(runs: dict[tuple[str, str], Runs]) -> str:
    """Return the scores of each task, and figures over the compared tasks, as Markdown."""
    heads = ["reward", "algorithm", *(f"`{task}`" for task in TASKS)]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for (reward, name), each in runs.items():
        cells = [f"{np.mean(s):.2f} ({len(s)})" if (s := each.scores.get(task)) else NONE for task in TASKS]
        lines.append("| " + " | ".join([reward, name, *cells]) + " |")
    heads = ["reward", "algorithm", "tasks", "seeds", "interquartile mean", "above 0, %", "CPU, s", "memory, MiB"]
    lines += ["", "| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for (reward, name), each in runs.items():
        (n_seed, n_task), middle = each.matrix.shape, interquartile_mean(each.matrix)
        above = 100.0 * profile(each.matrix, np.zeros(1))[0]
        cells = [n_task, n_seed, estimate(middle, 2) if n_seed > 1 else f"{middle.value:.2f}", f"{above:.0f}"]
        cells += [f"{each.mean_of('cpu_s'):.0f}", f"{each.mean_of('peak_mib'):.0f}"]
        lines.append("| " + " | ".join(map(str, [reward, name, *cells])) + " |")
    return "\n".join(lines)


def profiles_figure(runs: dict[tuple[str, str], Runs]) -> Figure:
    """Draw the share of runs with at least a score, a panel for each reward."""
    rewards, thresholds = list(dict.fromkeys(reward for reward, _ in runs)), np.linspace(LOWEST, HIGHEST, 401)
    figure = new_figure(4.2 * len(rewards), 3.2)
    for i, reward in enumerate(rewards):
        ax = figure.add_subplot(1, len(rewards), i + 1)
        for (of, name), each in runs.items():
            if of == reward:
                ax.plot(thresholds, profile(each.matrix, thresholds), color=COLOURS[name], linewidth=1.6, label=name)
        label_axes(ax, "score", "share of runs above it", f"reward: {reward}")
        ax.axvline(0.0, color="black", linewidth=0.6)
        ax.set_ylim(-0.02, 1.02)
        ax.legend(fontsize=8, frameon=False)
    return figure


@dataclass(frozen=True)
class AlgorithmTables(Command):
    """Print tables of algorithms and their profiles.

    The trainings are those of `libraries --out docs/algorithms.json`.
    """

    data: Path = DATA
    """File of the trainings."""
    figure: Path = FIGURE
    """Picture to write."""

    def run(self) -> None:
        """Print and draw. ValueError if the file has no trainings, or one of another algorithm."""
        check_file("figure", self.figure)
        records = records_in(self.data)
        unknown = {one["library"] for one in records} - set(NAMES)
        if unknown or not records:
            found = f"has trainings of {', '.join(sorted(unknown))}" if unknown else "has no trainings"
            raise ValueError(f"data: {self.data} {found}; make it by `libraries` with {', '.join(NAMES)}")
        runs = runs_by_reward(records)
        write_figure(self.figure, profiles_figure(runs), dpi=130)
        print(tables(runs))
