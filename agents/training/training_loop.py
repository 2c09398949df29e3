"""The loop of the algorithms that train by iterations: validation, the best policy, the curve and checkpoints."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

from rich.console import Console

from dcgrid_env import Scenario
from dcgrid_env.agents.policy.card import Card
from dcgrid_env.agents.policy.input_range import recorded
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.policy.policy_file import SUFFIX
from dcgrid_env.agents.training.run_folder import Run
from dcgrid_env.core.commands.progress import progress_bar
from dcgrid_env.core.compiled import compiling_s


def train(
    run: Run,
    learner: Any,
    iterations: int,
    validate: Callable[[Policy], Mapping[str, float]],
    reference: tuple[str, float],
    *,
    merit: Callable[[Mapping[str, float]], float] = lambda figures: figures["J"],
    scenarios: Sequence[Scenario] = (),
) -> Path:
    """Train from the checkpoint of the run, if it has one, and return the output folder.

    Parameters
    ----------
    run
        Folder of the run; its configuration has ``validate_every`` and ``checkpoint_every``.
    learner
        The algorithm. ``iterate(iteration, run)`` does an iteration, from 1 on, and returns figures for the curve;
        ``policy()`` returns the current policy; ``state()`` and ``restore(state)`` are for checkpoints.
    iterations
        Number of iterations.
    validate
        Function that returns figures of a policy on validation, with J.
    reference
        Name of the law with which validation compares the policy, and its J.
    merit
        Selection criterion of the figures on validation, smallest for the best policy.
    scenarios
        See :func:`finish`.
    """
    cfg: Any = run.config
    best, done = math.inf, 0
    law = f"{reference[0]} {reference[1]:.4f}"
    if (state := run.load()) is not None:
        learner.restore(state)
        best, done = state["best"], state["iteration"]
    with progress(f"{cfg.scenario}, {cfg.algorithm()}", iterations, done) as advance:
        for iteration in range(done + 1, iterations + 1):
            run.step, text, is_last = iteration, "", iteration == iterations
            figures = learner.iterate(iteration, run)
            if iteration % cfg.validate_every == 0 or is_last:
                policy = learner.policy()
                validated = validate(policy)
                if merit(validated) < best:
                    best = float(merit(validated))  # a number that a checkpoint may contain
                    run.keep(policy, float(validated["J"]))
                run.record({**validated, **figures})
                text = f"J {validated['J']:.4f}, {law}"
            if iteration % cfg.checkpoint_every == 0 or is_last:
                run.save({**learner.state(), "best": best, "iteration": iteration})
            advance(iteration, text)
    finish(run, scenarios)
    print(f"{run.folder}: best on validation {best:.4f}, {law}, {run.seconds:.0f} s")
    return run.folder


def finish(run: Run, scenarios: Sequence[Scenario] = ()) -> None:
    """Add the duration of the run and the range of the inputs to the best policy's card.

    ``scenarios`` are the training scenarios, if they include more than the validation scenarios, such as variants.
    """
    path = run.folder / "policy.json"
    inputs = recorded(Policy.load(path.with_suffix(SUFFIX)), scenarios or run.scenarios)
    dataclasses.replace(Card.load(path), training_s=run.seconds, inputs=inputs).save(path)


@contextmanager
def progress(description: str, total: int, done: int) -> Iterator[Callable[..., None]]:
    """Show the progress of a training and yield ``advance(completed, text)``.

    ``text`` has the figures of a validation. A terminal shows a bar with the last figures and the time left. Other
    outputs, such as log files, receive a line for each validation.
    """
    console, began_s = Console(), _computing_s()
    if not console.is_terminal:

        def line(completed: int, text: str = "") -> None:
            if text:
                left_s = (_computing_s() - began_s) / max(1, completed - done) * (total - completed)
                share = f"{100 * completed // total} % of {total} iterations"
                print(f"{description}: {share}, {text}, {timedelta(seconds=round(left_s))} left", flush=True)

        yield line
        return
    with progress_bar(console) as bar:
        task = bar.add_task(description, total=total, completed=done)

        def advance(completed: int, text: str = "") -> None:
            bar.update(task, completed=completed, description=f"{description}, {text}" if text else None)

        yield advance


def _computing_s() -> float:
    """Return a time, s, that excludes the compilation of kernels."""
    return time.monotonic() - compiling_s()
