"""Read an output folder of ``dcgrid run``: its command, scenario and costs."""

from __future__ import annotations

import contextlib
import io
import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from dcgrid_env.cli.run import Run, controller_names, scenario_of
from dcgrid_env.core.checked import finite
from dcgrid_env.core.commands.names import split_names
from dcgrid_env.core.user_files import is_file, read_json

if TYPE_CHECKING:
    from dcgrid_env import Scenario

RESULTS = "results.json"
OTHERWISE = "pass --scenario, or in Python call dcgrid_env.rendering.replay(recorder.series(0))"
"""Alternatives to replaying a folder of ``dcgrid run``."""


class StoredRun(NamedTuple):
    """A run that can be repeated: its results depend only on its scenario and seeds."""

    command: Run
    scenario: Scenario
    costs: dict[tuple[str, int], float]
    """Cost J by controller and seed."""

    @property
    def controllers(self) -> list[str]:
        """Names of the controllers in the run's command."""
        return controller_names(self.command, self.scenario)

    def difference(self, name: str, seed: int, cost: float) -> str:
        """Return a warning if an episode's cost differs from the stored one; empty if it does not."""
        stored = self.costs.get((name, seed))
        if stored is None or math.isclose(stored, cost, rel_tol=1e-9, abs_tol=1e-12):
            return ""
        return (
            f"warning: {name}: J is {cost:.6g}, but {stored:.6g} in the stored run; the package, a policy file or the "
            "gains have changed since"
        )


def stored_run(folder: Path, trust: bool) -> StoredRun:
    """Read a folder of ``dcgrid run``.

    Raises
    ------
    ValueError
        If it is not a folder of ``dcgrid run``, the run names code and ``trust`` is not set, or its scenario has
        changed.
    """
    from dcgrid_env import scenario_hash

    path = folder / RESULTS
    if not is_file(path, ValueError):
        raise ValueError(
            f"{folder}: must be an output folder of dcgrid run with {RESULTS}; run dcgrid run first, {OTHERWISE}"
        )
    try:
        stored = read_json(path, ValueError, "repeat the run")
        words = shlex.split("" + stored["meta"]["command"])  # a TypeError if it is not text
        expected = stored["meta"]["scenario_hash"]
        costs = {(e["controller"], e["seed"]): e["J"] for e in stored["episodes"]}
        for (name, seed), cost in costs.items():
            if not (isinstance(name, str) and type(seed) is int and finite(cost)):
                raise ValueError(f"J of episode {seed!r} of {name!r} must be a finite number, got {cost!r}")
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"{path}: must be a file of dcgrid run ({type(error).__name__}: {error}); repeat the run"
        ) from None
    command = _command(path, words)
    if not trust:
        _check_code(path, command)
    scenario = scenario_of(command)
    if scenario_hash(scenario) != expected:
        raise ValueError(
            f"{path}: scenario has changed since the run (hash {scenario_hash(scenario)}, was {expected!r}), because "
            "its files or the package changed; repeat the run"
        )
    run = StoredRun(command, scenario, costs)
    for name in run.controllers:
        if (name, command.seed) not in costs:
            raise ValueError(
                f"{path}: episodes must include {name!r} with seed {command.seed}, as in its command; repeat the run"
            )
    return run


def _command(path: Path, words: list[str]) -> Run:
    if words[:2] != ["dcgrid", "run"]:
        raise ValueError(
            f"{path}: must be written by dcgrid run, got {' '.join(words[:3])!r}; replay a run, {OTHERWISE}"
        )
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            return Run.parse([word for word in words[2:] if word != "--traceback"], "dcgrid run")
    except SystemExit:
        raise ValueError(
            f"{path}: this version cannot parse the command {shlex.join(words)!r}; repeat the run"
        ) from None


def _check_code(path: Path, command: Run) -> None:
    """Raise ValueError if repeating the run would import code that it names."""
    from dcgrid_env.baselines.registry import split_prefix
    from dcgrid_env.baselines.user_code import parse

    named = [command.scenario or "", *(split_prefix(name)[1] for name in split_names(command.controllers or ""))]
    for name in named:
        if name and parse(name) is not None:
            raise ValueError(
                f"{path}: must not name code unless trusted, got {name!r}; add --trust if you trust its author"
            )
