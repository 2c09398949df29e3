"""The command ``python -m docs.studies soak``: memory, finite figures and speed of long runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from dcgrid_env import PRESETS, DcgridEnv, DcgridVectorEnv, make_scenario, read_feeder
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.settings import at_least
from dcgrid_env.scenario.on_feeder import scenario_on
from docs.studies.speed.environment_rates import resident_mib
from docs.studies.speed.synthetic_feeders import three_phase_feeder

NUM_ENVS = 512
DAY_STEPS = 1440
"""Steps of a minute in a day."""
PARTS = 10
"""Parts of a run, of which the second and the last are compared: the first fills caches."""


@dataclass(frozen=True)
class Soak(Command):
    """Run environments for long and look at memory and speed.

    Three runs: random actions in a batch of ``ieee33-weak``; resets of every preset, each with a step; and days in
    steps of a minute on a three-phase feeder of 8,500 nodes. The table has the number of figures that are not finite,
    and memory and steps per second of CPU time in the second and the last tenth of a run.
    """

    steps: int = 10_000_000
    """Environment steps of the batch, together."""
    resets: int = 10_000
    """Resets of each preset."""
    days: int = 24
    """Days on the large feeder."""
    feeder: Path | None = None
    """Folder of the large feeder; a synthetic one by default."""

    def run(self) -> None:
        """Run and print. ValueError for an invalid setting."""
        at_least(self, steps=PARTS * NUM_ENVS, resets=PARTS, days=1)
        heads = ("run", "steps", "not finite", "MiB early", "MiB late", "steps/s early", "steps/s late")
        print("| " + " | ".join(heads) + " |")
        print("|---" + "|---:" * (len(heads) - 1) + "|")
        for name, step, count, n_env in self._runs():
            print(f"| {name} | {' | '.join(_row(step, count, n_env))} |", flush=True)

    def _runs(self) -> Iterator[tuple[str, Callable[[int], Any], int, int]]:
        """Yield the name of each run, its step by number, the number of steps, and the environments of a step."""
        batch = DcgridVectorEnv(NUM_ENVS, "ieee33-weak", info="none")
        batch.reset(seed=0)
        assert batch.action_space.shape is not None
        actions = np.random.default_rng(0).uniform(-1.0, 1.0, (100, *batch.action_space.shape)).astype(np.float32)
        yield (
            f"batch of {NUM_ENVS}, `ieee33-weak`",
            lambda i: batch.step(actions[i % 100]),
            self.steps // NUM_ENVS,
            NUM_ENVS,
        )
        for preset in PRESETS:
            env = DcgridEnv(preset, info="none")
            action = env.action_space.sample()
            yield (
                f"resets of `{preset}`",
                lambda i, env=env, action=action: (*env.reset(seed=i), *env.step(action)),
                self.resets,
                1,
            )
        feeder = three_phase_feeder(8500) if self.feeder is None else read_feeder(self.feeder)
        chosen = scenario_on(feeder).replace(dt_s=60.0, horizon=self.days * DAY_STEPS)
        long = DcgridEnv(make_scenario(chosen), info="none")
        long.reset(seed=0)
        action = np.zeros_like(long.action_space.sample())
        yield f"{self.days} days, {feeder.n_node:,} nodes", lambda _: long.step(action), self.days * DAY_STEPS, 1


def _row(step: Callable[[int], Any], count: int, n_env: int) -> list[str]:
    """Run ``count`` steps, and return the figures of the table."""
    rates, memory, wrong, ends = [], [], 0, np.linspace(0, count, PARTS + 1).astype(int)
    for first, end in pairwise(ends):
        began_s = process_time()
        for i in range(first, end):
            wrong += sum(not np.isfinite(part).all() for part in step(i) if not isinstance(part, dict))
        rates.append((end - first) * n_env / (process_time() - began_s))
        memory.append(resident_mib())
    figures = (count * n_env, wrong, memory[1], memory[-1], rates[1], rates[-1])
    return [f"{figure:,.0f}" for figure in figures]
