"""Units of work: some test episodes of a scenario under a controller, and what is kept of them."""

from __future__ import annotations

import contextlib
import hashlib
import inspect
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import asdict, dataclass
from pathlib import Path, PurePath
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from dcgrid_env import Recorder, Scenario, __version__, scenario_hash
from dcgrid_env.baselines import Controller, NeedsPlacement, find_controller, rollout
from dcgrid_env.baselines.controller import with_figures
from dcgrid_env.baselines.evaluation import episode_records
from dcgrid_env.baselines.registry import controller_file, split_prefix
from dcgrid_env.baselines.rollout import ControllerError
from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.baselines.score import SPLIT
from dcgrid_env.baselines.user_code import described, one_line, parse

UNIT_EPISODES = 25
"""Episodes of a unit: enough for the batch to pay, few enough that an interruption costs little of a slow controller's
work. Units are cut alike however many processes there are, so that results do not hang on that."""

V_EDGES_PU = np.linspace(0.80, 1.20, 401)
"""Bins of the voltage histogram, p.u.; what lies beyond counts in the first or last."""


@dataclass(frozen=True)
class Unit:
    """What defines a unit's result."""

    scenario: str
    """The scenario's own name."""
    controller: str
    """What it is called on the command line."""
    first: int
    """Its first seed."""
    episodes: int
    scenario_hash: str
    controller_hash: str
    version: str
    """Version of this package."""

    @property
    def label(self) -> str:
        """What messages call it."""
        return f"{self.scenario}, {self.controller}, seeds {self.first} to {self.seeds[-1]}"

    @property
    def seeds(self) -> range:
        """Seeds of its episodes."""
        return range(self.first, self.first + self.episodes)


GIVES_ANOTHER = "failed: {} gives another scenario in each process; let it draw nothing at random, or from a fixed seed"

CODE = (type, FunctionType, BuiltinFunctionType, ModuleType, np.ufunc)
"""Types of a controller's attributes that are code instead of parameters."""


@dataclass(frozen=True)
class Case:
    """A scenario on the test split and where its tuned gains come from, as processes hand it to each other."""

    spec: ScenarioSpec
    tuned: Path | None = None
    """A file of ``dcgrid tune``; None as for ``make_controller``."""

    def scenario(self) -> Scenario:
        """The scenario; one object in a process."""
        return self.spec.make(SPLIT)

    def controller(self, name: str) -> Controller:
        """A fresh controller for it; ValueError where there is none."""
        return find_controller(name, self.scenario(), self.tuned)


@dataclass(frozen=True)
class Task:
    """A unit and what it takes to run it."""

    unit: Unit
    case: Case


def plan(
    cases: Sequence[Case], controllers: Sequence[str], episodes: int
) -> tuple[list[Task], dict[tuple[str, str], str]]:
    """Units for all pairs, scenario by scenario, and why the rest have none, by (scenario, controller)."""
    tasks: list[Task] = []
    failures: dict[tuple[str, str], str] = {}
    for case in cases:
        scenario = case.scenario()
        form, name = scenario_hash(scenario), scenario.name
        for spec in controllers:
            try:
                identity = controller_hash(case.controller(spec), spec)
            except ValueError as error:
                failures[name, spec] = f"does not apply: {one_line(error)}"
                continue
            except Exception as error:
                failures[name, spec] = f"failed: {described(error)}"
                continue
            for first in range(0, episodes, UNIT_EPISODES):
                count = min(UNIT_EPISODES, episodes - first)
                tasks.append(Task(Unit(name, spec, first, count, form, identity, __version__), case))
    return tasks, failures


def run(task: Task) -> dict[str, Any]:
    """The unit's record: what defines it, its episodes and voltages, or ``failure``, one line."""
    unit = task.unit
    try:
        scenario, controller = task.case.scenario(), task.case.controller(unit.controller)
        if scenario_hash(scenario) != unit.scenario_hash:
            return _failure(unit, GIVES_ANOTHER.format(task.case.spec.where))
        recorder = rollout(scenario, controller, unit.seeds, name=unit.controller)
    except ControllerError as error:
        return _failure(
            unit, f"does not apply: {error.reason}" if error.refuses else f"failed in {error.where}: {error.reason}"
        )
    except (Exception, SystemExit) as error:  # whatever the user's code does, the others go on
        return _failure(unit, f"failed: {described(error)}")
    metrics, counts = _figures(recorder, unit.episodes)
    metrics = with_figures(controller, metrics)
    return {
        "unit": asdict(unit),
        "observes": observed(controller, scenario),
        "episodes": episode_records(unit.scenario, unit.controller, unit.seeds, metrics, unit.first),
        "voltage": {"first_bin": int(np.flatnonzero(counts)[0]), "counts": np.trim_zeros(counts).tolist()},
    }


def _failure(unit: Unit, text: str) -> dict[str, Any]:
    return {"unit": asdict(unit), "failure": text}


def observed(controller: Controller, scenario: Scenario) -> str:
    """Describe the observation of a controller in words."""
    scope = getattr(controller, "observe", scenario.sensing.observe)
    knows = getattr(controller, "scope", "feeder's model" if isinstance(controller, NeedsPlacement) else "")
    return f"{scope}, {knows}" if knows else scope


def controller_hash(controller: Controller, spec: str = "") -> str:
    """Hash a new controller: SHA-256 over its parameters, its class's file, and the file and arguments in ``spec``.

    The result has 16 hexadecimal digits.
    """
    digest = hashlib.sha256(f"{type(controller).__module__}.{type(controller).__qualname__}".encode())
    with contextlib.suppress(TypeError, OSError):  # made without a file
        digest.update(Path(inspect.getfile(type(controller))).read_bytes())
    _, spec = split_prefix(spec)
    reference = parse(spec)
    file = reference.path if reference else controller_file(spec)
    if file is not None:
        digest.update(file.read_bytes())
    if reference and (reference.positional or reference.keywords):
        digest.update(repr((reference.positional, reference.keywords)).encode())
    _add(digest, controller, {})
    return digest.hexdigest()[:16]


def _figures(recorder: Recorder, n_env: int) -> tuple[list[dict[str, float]], np.ndarray]:
    """Metrics of each environment, and counts of all voltages in the bins of ``V_EDGES_PU``."""
    metrics, counts = [], np.zeros(len(V_EDGES_PU) - 1, dtype=np.int64)
    for env_index in range(n_env):
        series = recorder.series(env_index)
        metrics.append(series.metrics())
        inside = np.clip(series.v_pu[1:, series.scenario.feeder.load_slice], V_EDGES_PU[0], V_EDGES_PU[-1])
        counts += np.histogram(inside, V_EDGES_PU)[0]
    return metrics, counts


def _add(digest: Any, value: object, places: dict[int, tuple[int, Any]]) -> None:
    """Feed a parameter by value; of code its name, of what has no value to read the type alone.

    ``places`` holds the place and the object of those fed before, by ``id``: one met again is fed as its place.
    """
    digest.update(f"{type(value).__qualname__}:".encode())
    if isinstance(value, str | bytes | int | float | complex | np.generic | PurePath | None):
        digest.update(f"{value!r};".encode())
    elif isinstance(value, CODE):
        # SciPy's ufuncs have no __qualname__, NumPy's have one from 2.2 on.
        name = getattr(value, "__qualname__", value.__name__ if isinstance(value, np.ufunc) else "")
        digest.update(f"{getattr(value, '__module__', '')}.{name};".encode())
    elif isinstance(value, tuple):
        _add_all(digest, value, places)
    elif id(value) in places:
        digest.update(f"{places[id(value)][0]};".encode())
    else:
        places[id(value)] = (len(places), value)
        _add_content(digest, value, places)


def _add_content(digest: Any, value: Any, places: dict[int, tuple[int, Any]]) -> None:
    """Feed what an object holds: its items or figures, and its attributes."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            digest.update(f"{key!r}=".encode())
            _add(digest, item, places)
    elif isinstance(value, list):
        _add_all(digest, value, places)
    elif isinstance(value, AbstractSet):
        _add_all(digest, sorted(value, key=repr), places)
    elif isinstance(value, np.ndarray):
        digest.update(f"{value.shape}{value.dtype}".encode())
        if value.dtype == object:
            _add_all(digest, value.ravel().tolist(), places)
        else:
            digest.update(value.tobytes())
    elif isinstance(value, MethodType):
        digest.update(f"{value.__qualname__};".encode())
        _add(digest, value.__self__, places)
    elif hasattr(value, "tolist"):  # another library's array
        with contextlib.suppress(Exception):
            digest.update(f"{value.tolist()!r};".encode())
    for name, item in _attributes(value):
        digest.update(f".{name}=".encode())
        _add(digest, item, places)


def _attributes(value: object) -> list[tuple[str, Any]]:
    attributes = list(getattr(value, "__dict__", {}).items())
    for kind in type(value).__mro__:
        slots = vars(kind).get("__slots__", ())
        names = (slots,) if isinstance(slots, str) else slots
        attributes += [(name, getattr(value, name)) for name in names if name[:2] != "__" and hasattr(value, name)]
    return attributes


def _add_all(digest: Any, values: Sequence[Any], places: dict[int, tuple[int, Any]]) -> None:
    digest.update(f"{len(values)};".encode())
    for value in values:
        _add(digest, value, places)
