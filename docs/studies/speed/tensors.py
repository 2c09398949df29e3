"""How fast batches of torch tensors step, with and without the derivative: a part of the command ``speed``.

The first steps of episodes under random actions drawn beforehand. Episodes are drawn once, and many
environments are copies of a few, so that what is measured is the steps. With the derivative, their cost is
differentiated by every action.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterable, Iterator
from copy import copy
from functools import partial
from importlib.util import find_spec

from dcgrid_env.core.suggestions import from_clone
from dcgrid_env.engine.physics.actions import action_layout
from dcgrid_env.envs.tensor import TensorEnv
from dcgrid_env.scenario.scenario import Scenario
from docs.studies.speed.measuring import Row, rate

NUM_ENVS = {"cpu": (1024, 4096), "cuda": tuple(1024 * 4**k for k in range(5))}
"""Environments in the batches that are measured, by the kind of device."""
PRECISIONS = ("float32", "float64")
"""Precisions of the measured tensors."""
EPISODES = 256  # different ones in a batch
WINDOW = 20  # steps in a call, and so those through which a derivative reaches back
UNIT = "environment steps/s"
MISSING = f"not installed ({from_clone('agents')})"


def tensor_rows(scenario: Scenario, device: str, seconds: float) -> Iterator[Row]:
    """Steps of ``TensorEnv`` on a device, without and with the derivative, for each size of batch that fits.

    ValueError for a device that torch does not know or this machine does not have.
    """
    if find_spec("torch") is None:
        return iter([Row("TensorEnv, torch", None, MISSING)])
    return _rows(scenario, device, NUM_ENVS[kind_of(device)], seconds)


def _rows(scenario: Scenario, device: str, sizes: Iterable[int], seconds: float) -> Iterator[Row]:
    for num_envs in sizes:
        for precision in PRECISIONS:
            for gradient in (False, True):
                name = f"TensorEnv, {num_envs} environments, torch {device} {precision}" + (
                    f", gradient over {WINDOW} steps" if gradient else ""
                )
                steps = num_envs * min(WINDOW, scenario.horizon)
                window = partial(_window, scenario, device, precision, num_envs, gradient)
                per_s = measured(window, steps, device, seconds)
                yield Row(name, per_s, UNIT if per_s is not None else "does not fit into memory")


def kind_of(device: str) -> str:
    """The kind of a device, a key of ``NUM_ENVS``; ValueError for one that is not there."""
    import torch

    choice = f"give one of {', '.join(NUM_ENVS)}"
    try:
        parsed = torch.device(device)
    except RuntimeError:
        raise ValueError(f"device is {device!r}, which torch does not know; {choice}") from None
    if parsed.type not in NUM_ENVS:
        raise ValueError(f"device is {device!r}; {choice}")
    if parsed.type == "cuda":
        count = torch.cuda.device_count() if torch.cuda.is_available() else 0
        if (parsed.index or 0) >= count:
            raise ValueError(f"device is {device!r}, but torch finds {count} of that kind here; give cpu")
    return parsed.type


def measured(made: Callable[[], Callable[[], object]], amount: float, device: str, seconds: float) -> float | None:
    """The rate of what ``made`` gives, see ``rate``; None where the device's memory does not hold it."""
    import torch

    try:
        return rate(made(), amount, seconds)
    except torch.OutOfMemoryError:
        return None
    finally:
        gc.collect()
        if torch.device(device).type == "cuda":
            torch.cuda.empty_cache()


def _window(scenario: Scenario, device: str, precision: str, num_envs: int, gradient: bool) -> Callable[[], object]:
    """What drives a batch through the first window of its episodes."""
    import torch

    kind = {"dtype": getattr(torch, precision), "device": device}
    env = TensorEnv(scenario, like=torch.empty(0, **kind))
    steps = min(WINDOW, scenario.horizon)
    n_action = action_layout(scenario).n
    generator = torch.Generator(device).manual_seed(0)
    drawn = 2.0 * torch.rand((steps, num_envs, n_action), generator=generator, **kind) - 1.0
    drawn.requires_grad_(gradient)
    env.reset(range(min(EPISODES, num_envs)), copies=-(-num_envs // EPISODES))

    def window() -> None:
        again = copy(env)  # the same episodes, without drawing them
        costs = [again.step(action).cost_j.mean() for action in drawn]
        if gradient:
            torch.stack(costs).sum().backward()
            drawn.grad = None
        if drawn.is_cuda:
            torch.cuda.synchronize()

    return window
