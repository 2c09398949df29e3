"""Mean and spread of what networks see, over episodes at random setpoints: observations, and how they change."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from dcgrid_env import RandomFeeders, Scenario, TensorEnv, action_layout
from dcgrid_env.agents.policy.history_network import with_changes
from dcgrid_env.agents.policy.interface import PolicyInterface
from dcgrid_env.agents.training.run_folder import torch

REMEMBERED = ("v_deviation", "p", "q", "p_ref_next")
"""Fields of an agent whose changes a policy with a history sees: its voltage, its powers, and what work is coming."""
LEAST_SPREAD, LEAST_CHANGE = 1e-2, 1e-3
"""Least standard deviation that figures, and changes of them, are divided by."""

NORMALISED_ENVS, NORMALISED_STEPS = 32, 10
"""Episodes, and steps between new setpoints, of the rollout that normalises observations."""
FEEDERS = 8
"""Feeders over which that rollout goes where they are random."""


def episode_seeds(seed: int, iteration: int, num_envs: int) -> range:
    """Seeds of a batch of episodes; no two batches of a run, nor runs of other seeds, share one."""
    first = (seed << 40) + iteration * num_envs
    return range(first, first + num_envs)


def normalising_seeds(scenario: Scenario, seed: int) -> list[range]:
    """Seeds of the episodes that normalise observations, a batch on each of several feeders where they are random."""
    if not isinstance(scenario.feeder, RandomFeeders):
        return [episode_seeds(seed, 0, NORMALISED_ENVS)]
    n_env = min(NORMALISED_ENVS, scenario.feeder.batch)
    first = [(seed << 40) + i * scenario.feeder.batch for i in range(FEEDERS)]
    return [range(start, start + n_env) for start in first]


def remembered_columns(interfaces: Sequence[PolicyInterface]) -> dict[str, list[int]]:
    """Where what each network sees has the fields of ``REMEMBERED``."""
    fields = {name: names for interface in interfaces for name, names in interface.input_fields.items()}
    return {
        name: [i for i, field in enumerate(names) if field.rpartition(".")[2] in REMEMBERED]
        for name, names in fields.items()
    }


def normalisation(
    envs: Sequence[TensorEnv],
    interfaces: Sequence[PolicyInterface],
    seed: int,
    tensor: Callable[[np.ndarray], torch.Tensor],
    columns: Mapping[str, Sequence[int]],
    steps: int,
) -> dict[str, tuple[torch.Tensor, torch.Tensor]]:
    """Mean and standard deviation of what each network sees, over episodes of each grid at random setpoints.

    Parameters
    ----------
    envs, interfaces
        A grid each.
    seed
        The training's.
    tensor
        Makes tensors of the envs' kind.
    columns, steps
        Columns whose last changes each network sees, by its name, and how many of each; none of one that is not named.

    Returns
    -------
    dict
        (n_in + steps n_column,) each, by the network's name.
    """
    rng, rows_by_network = np.random.default_rng(seed), {}
    grids = zip(envs, interfaces, strict=True)
    for env, interface, seeds in ((*grid, of) for grid in grids for of in normalising_seeds(grid[0].scenario, seed)):
        clocks = action_layout(env.scenario).is_channel("clock")
        joint, earlier = env.reset(seeds), {}
        action = torch.empty(0)
        while not env.over:
            if env.step_number % NORMALISED_STEPS == 0:
                drawn = rng.uniform(-1.0, 1.0, (len(seeds), len(clocks)))
                drawn = np.where(clocks, 0.7 + 0.3 * drawn, drawn)  # clocks near the top
                action = tensor(drawn.astype(np.float32))
            joint = env.step(action).observation
            for name, inputs in interface.inputs(joint).items():
                if columns.get(name):
                    inputs, earlier[name] = with_changes(inputs, earlier.get(name), columns[name], steps)
                rows_by_network.setdefault(name, []).append(inputs.reshape(-1, inputs.shape[-1]))
    every = {name: torch.cat(rows) for name, rows in rows_by_network.items()}
    return {name: _moments(rows, steps * len(columns.get(name, ()))) for name, rows in every.items()}


def _moments(rows: torch.Tensor, n_change: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean and standard deviation of rows whose last columns are changes, which have a mean of 0."""
    mean, std = rows.mean(0), rows.std(0)
    if not n_change:
        return mean, std.clamp(min=LEAST_SPREAD)
    n = rows.shape[-1] - n_change
    return (
        torch.cat((mean[:n], torch.zeros_like(mean[n:]))),
        torch.cat((std[:n].clamp(min=LEAST_SPREAD), std[n:].clamp(min=LEAST_CHANGE))),
    )
