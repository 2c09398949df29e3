"""The command ``python -m docs.studies speed-training``: how fast training by gradients through the grid is."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from dataclasses import dataclass
from time import perf_counter, process_time

from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.terminal import plain_console
from docs.studies.speed.measuring import Row
from docs.studies.speed.rates import table


@dataclass(frozen=True)
class TrainingSpeed(Command):
    """Measure a training by gradients through the grid.

    Measures whole batches of episodes as ``dcgrid train analytic`` drives them: drawing them, the policy, the grid,
    the derivative, the optimiser's steps, without validation. Environment steps for each second of processor time are
    those of a core; those for each second of the clock depend on what else the machine does. Every rate is the median
    of several batches after a first one that is not counted.
    """

    scenario: str = "ieee33-weak"
    """Name of a scenario (dcgrid list)."""
    num_envs: tuple[int, ...] = (128, 1024, 4096)
    """Environments in a batch, several to measure one after the other."""
    batches: int = 3
    """Batches of episodes behind each figure."""
    history: int = 0
    """Steps back that the policy sees, see dcgrid train analytic."""
    device: str = "cpu"
    """Where networks and grid are, as torch names it."""

    def run(self) -> None:
        """Measure and print. ValueError for an invalid setting."""
        plain_console().print(table(list(training_rows(self)), self.scenario))


def training_rows(cfg: TrainingSpeed) -> Iterator[Row]:
    """Rates for each size of batch; ValueError for an invalid setting."""
    from dcgrid_env.agents.algorithms.analytic import Analytic
    from dcgrid_env.agents.training.config import check

    if cfg.batches < 1:
        raise ValueError(f"batches is {cfg.batches}; give at least 1")
    settings = {"device": cfg.device, "history": cfg.history}
    trained = [Analytic.for_scenario(cfg.scenario, num_envs=n, **settings) for n in cfg.num_envs]
    for each in trained:
        check(each)
        yield from _rows(each, cfg.batches)


def _rows(trained: object, batches: int) -> Iterator[Row]:
    """Rates of a configuration of ``analytic``, by processor time and by the clock."""
    import torch

    from dcgrid_env.agents.algorithms.analytic import Learner, grids_of

    torch.set_num_threads(1)
    learner = Learner(trained, grids_of(trained))  # pyright: ignore[reportArgumentType]
    cfg, env = learner.cfg, learner.envs[0]
    times_s = []
    for iteration in range(1, batches + 2):
        began_s = perf_counter(), process_time()
        learner.episodes(0, iteration, lambda what, tensors: None)
        if env.like.is_cuda:
            torch.cuda.synchronize()
        times_s.append((perf_counter() - began_s[0], process_time() - began_s[1]))
    steps = cfg.num_envs * env.scenario.horizon
    clock_s, cpu_s = (statistics.median(of_kind) for of_kind in zip(*times_s[1:], strict=True))
    name = f"analytic, {cfg.num_envs} environments, torch {cfg.device}"
    yield Row(name, steps / cpu_s, "steps with updates per s of processor time")
    yield Row(name, steps / clock_s, "steps with updates per s of the clock")
