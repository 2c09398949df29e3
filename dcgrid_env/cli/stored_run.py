"""What stands behind a folder of ``dcgrid run``: its command, which is read again, and what came out of it."""

from __future__ import annotations

import contextlib
import io
import json
import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from dcgrid_env.cli.names import split_names
from dcgrid_env.cli.run import Run, controller_names, scenario_of
from dcgrid_env.core.checked import finite

if TYPE_CHECKING:
    from dcgrid_env import Scenario

RESULTS = "results.json"
OTHERWISE = "give --scenario, or hand what Python has recorded to dcgrid_env.rendering.replay(recorder.lane(0))"
"""What else can be replayed than a folder of ``dcgrid run``."""


class StoredRun(NamedTuple):
    """A run that can be done again: everything that it draws follows from its scenario and its seeds."""

    command: Run
    scenario: Scenario
    costs: dict[tuple[str, int], float]
    """J of each controller and seed."""

    @property
    def controllers(self) -> list[str]:
        """Names of the controllers in the run's command."""
        return controller_names(self.command, self.scenario)

    def difference(self, name: str, seed: int, cost: float) -> str:
        """What to say where an episode comes out otherwise than it is stored; empty where it does not."""
        stored = self.costs.get((name, seed))
        if stored is None or math.isclose(stored, cost, rel_tol=1e-9, abs_tol=1e-12):
            return ""
        return (
            f"{name}: J is {cost:.6g} and was {stored:.6g} when the run was stored: the package, a policy's file or "
            "the gains have changed since"
        )


def stored_run(folder: Path, trust: bool) -> StoredRun:
    """Read a folder of ``dcgrid run``.

    Raises
    ------
    ValueError
        For a folder of something else, a run of code of somebody's own unless it is trusted, and a scenario that is no
        longer what was run.
    """
    from dcgrid_env import scenario_hash

    path = folder / RESULTS
    if not path.is_file():
        raise ValueError(f"{folder} is no folder of dcgrid run, it has no {RESULTS}; run first, {OTHERWISE}")
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        words = shlex.split("" + stored["meta"]["command"])  # a TypeError where it is no text
        expected = stored["meta"]["scenario_hash"]
        costs = {(e["controller"], e["seed"]): e["J"] for e in stored["episodes"]}
        for (name, seed), cost in costs.items():
            if not (isinstance(name, str) and type(seed) is int and finite(cost)):
                raise ValueError(f"episode {seed!r} of {name!r} has J {cost!r}, which is no finite number")
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"{path} is no file of dcgrid run ({type(error).__name__}: {error}); run again") from None
    command = _command(path, words)
    if not trust:
        _check_code(path, command)
    scenario = scenario_of(command)
    if scenario_hash(scenario) != expected:
        raise ValueError(
            f"{path}: its scenario is another one now ({scenario_hash(scenario)}, was {expected!r}), as its files or "
            "the package have changed; run again"
        )
    run = StoredRun(command, scenario, costs)
    for name in run.controllers:
        if (name, command.seed) not in costs:
            raise ValueError(
                f"{path}: episodes has none of {name!r} and seed {command.seed}, its command has; run again"
            )
    return run


def _command(path: Path, words: list[str]) -> Run:
    if words[:2] != ["dcgrid", "run"]:
        raise ValueError(
            f"{path} was not written by dcgrid run but by {' '.join(words[:3])!r}; replay a run, {OTHERWISE}"
        )
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            return Run.parse([word for word in words[2:] if word != "--traceback"], "dcgrid run")
    except SystemExit:
        raise ValueError(f"{path}: this version cannot read its command {shlex.join(words)!r}; run again") from None


def _check_code(path: Path, command: Run) -> None:
    """ValueError where doing the run again would import somebody's code."""
    from dcgrid_env.baselines.registry import split_prefix
    from dcgrid_env.baselines.user_code import parse

    named = [command.scenario or "", *(split_prefix(name)[1] for name in split_names(command.controllers or ""))]
    for name in named:
        if name and parse(name) is not None:
            raise ValueError(f"{path} names code, {name!r}, which a replay would run; if you trust it, add --trust")
