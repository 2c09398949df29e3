"""How fast the environments step, and how much memory a batch takes: a part of the command ``speed``."""

from __future__ import annotations

import gc
import itertools
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from dcgrid_env.scenario.scenario import Scenario
from docs.studies.speed.measuring import ROOT, Row, rate


def environment_rows(scenario: Scenario, num_envs: int, seconds: float) -> Iterator[Row]:
    """Steps of the environments. A call is a whole episode, so that each block has its share of resets."""
    steps = scenario.horizon
    yield Row("parallel_env", rate(_parallel_episode(scenario), steps, seconds), "steps/s")
    yield Row("gymnasium.make", rate(_single_episode(scenario), steps, seconds), "steps/s")
    yield Row("rgb_array, a step each", rate(_single_episode(scenario, "rgb_array"), steps, seconds), "frames/s")
    per_s = rate(_batch_episode(scenario, num_envs), steps * num_envs, seconds)
    yield Row(f"DcgridVectorEnv, {num_envs} environments", per_s, "environment steps/s")
    yield Row(f"DcgridVectorEnv, {num_envs} environments", per_s * scenario.n_agents, "agent steps/s")


def three_phase_environment_rows(scenario: Scenario, num_envs: int, seconds: float) -> Iterator[Row]:
    """Steps of the environments on a three-phase feeder, one at a time and in a batch."""
    steps, name = scenario.horizon, scenario.name
    yield Row(f"gymnasium.make, {name}", rate(_single_episode(scenario), steps, seconds), "steps/s")
    per_s = rate(_batch_episode(scenario, num_envs), steps * num_envs, seconds)
    yield Row(f"DcgridVectorEnv, {num_envs} environments, {name}", per_s, "environment steps/s")


def _parallel_episode(scenario: Scenario) -> Callable[[], object]:
    from dcgrid_env import parallel_env

    env, rng = parallel_env(scenario), np.random.default_rng(0)
    sizes = {agent: env.action_space(agent).shape for agent in env.possible_agents}
    drawn = [
        {agent: rng.uniform(-1.0, 1.0, size).astype(np.float32) for agent, size in sizes.items()}
        for _ in range(scenario.horizon)
    ]
    env.reset(seed=0)

    def episode() -> None:
        for action in drawn:
            env.step(action)
            if not env.agents:
                env.reset()

    return episode


def _single_episode(scenario: Scenario, render_mode: str | None = None) -> Callable[[], object]:
    import gymnasium

    from dcgrid_env import IDS

    id_of = {name: registered for registered, name in IDS.items()}
    env, rng = gymnasium.make(id_of[scenario.name], render_mode=render_mode), np.random.default_rng(0)
    drawn = rng.uniform(-1.0, 1.0, (scenario.horizon, *(env.action_space.shape or ()))).astype(np.float32)
    env.reset(seed=0)

    def episode() -> None:
        for action in drawn:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
            if render_mode is not None:
                env.render()

    return episode


def _batch_episode(scenario: Scenario, num_envs: int) -> Callable[[], object]:
    from dcgrid_env import DcgridVectorEnv

    env, rng = DcgridVectorEnv(num_envs, scenario), np.random.default_rng(0)
    drawn = rng.uniform(-1.0, 1.0, (16, *(env.action_space.shape or ()))).astype(np.float32)
    env.reset(seed=0)

    def episode() -> None:
        for _, action in zip(range(scenario.horizon), itertools.cycle(drawn), strict=False):
            env.step(action)  # an episode that is over is followed by its next in the same step

    return episode


def memory_row(scenario: str, num_envs: int) -> Row:
    """Growth of a fresh process by one large batch."""
    if find_spec("resource") is None:
        return Row(f"resident memory of {num_envs} environments", None, "not measured on this system")
    code = (
        "import sys; from docs.studies.speed.environment_rates import resident_growth_mib as grown; "
        "print(grown(sys.argv[1], int(sys.argv[2])))"
    )
    command = [sys.executable, "-c", code, scenario, str(num_envs)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"the process that measures memory failed: {done.stderr.strip()}")
    mib = float(done.stdout)
    return Row(f"resident memory of {num_envs} environments ({1024 * mib / num_envs:.1f} KiB each)", mib, "MiB")


def resident_growth_mib(scenario: str, num_envs: int) -> float:
    """By how many MiB this process grows with a batch that has taken some steps; measure it in a fresh process."""
    from dcgrid_env import DcgridVectorEnv

    def stepped(n: int) -> object:
        env = DcgridVectorEnv(n, scenario)
        env.reset(seed=0)
        for _ in range(4):
            env.step(np.zeros(env.action_space.shape or (), dtype=np.float32))
        return env

    for n in (1, 256):  # imports, compiled code and threads are no part of an environment
        stepped(n)
    gc.collect()
    before = resident_mib()
    env = stepped(num_envs)
    gc.collect()
    after = resident_mib()
    del env
    return after - before


def resident_mib() -> float:
    """Return the resident memory of this process, MiB; its peak where the system does not report the current value."""
    import resource  # not on every system

    statm = Path("/proc/self/statm")
    if statm.exists():
        return int(statm.read_text().split()[1]) * resource.getpagesize() / 2**20
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)
