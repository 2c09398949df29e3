"""How much faster the environments step with less in ``info``: ieee123, random actions, resets included.

Levels take turns, an episode each, so that a busy machine slows all of them alike; the figures are medians over rounds.

    python -m docs.studies.speed.info_levels
"""

import time
from collections.abc import Callable, Iterable
from typing import Any

import gymnasium
import numpy as np

import dcgrid_env

LEVELS = ("full", "costs", "none")
N_ENV = 64
ROUNDS = 100


def played(env: Any, actions: Iterable[Any]) -> None:
    """An episode under given actions."""
    env.reset()
    for action in actions:
        env.step(action)


def single(info: str) -> Callable[[], None]:
    """An episode of ``gymnasium.make``."""
    env = gymnasium.make("dcgrid/IEEE123-v0", info=info)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (120, *(env.action_space.shape or ()))).astype(np.float32)

    return lambda: played(env, actions)


def many(info: str) -> Callable[[], None]:
    """An episode of ``parallel_env``."""
    env = dcgrid_env.parallel_env("ieee123", info=info)  # pyright: ignore[reportArgumentType]
    rng = np.random.default_rng(0)
    shapes = {agent: env.action_space(agent).shape for agent in env.possible_agents}
    actions = [{a: rng.uniform(-1.0, 1.0, s).astype(np.float32) for a, s in shapes.items()} for _ in range(120)]

    return lambda: played(env, actions)


def batch(info: str) -> Callable[[], None]:
    """An episode of ``gymnasium.make_vec``."""
    env = gymnasium.make_vec("dcgrid/IEEE123-v0", num_envs=N_ENV, info=info)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (120, *(env.action_space.shape or ()))).astype(np.float32)
    env.reset()

    def episode() -> None:
        for action in actions:  # the last one begins the next episode
            env.step(action)

    return episode


def main() -> None:
    """Print a line for each interface."""
    interfaces = {"gymnasium.make": single, "parallel_env": many, f"make_vec, {N_ENV} environments": batch}
    print(f"| steps/s more than with info='full' | {' | '.join(f'info={level!r}' for level in LEVELS[1:])} |")
    print("|---|---|---|")
    for name, make in interfaces.items():
        episodes = [make(level) for level in LEVELS]
        taken_s = np.zeros((ROUNDS, len(LEVELS)))
        for turn in range(ROUNDS):
            for i in np.roll(range(len(LEVELS)), turn):
                began_s = time.perf_counter()
                episodes[i]()
                taken_s[turn, i] = time.perf_counter() - began_s
        gains = np.median(taken_s[:, :1] / taken_s[:, 1:], axis=0) - 1.0
        print(f"| {name} | {' | '.join(f'{100.0 * gain:+.0f} %' for gain in gains)} |")


if __name__ == "__main__":
    main()
