"""Units of work: some test episodes of a scenario under a controller, and what is kept of them."""

from __future__ import annotations

import contextlib
import hashlib
import inspect
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path, PurePath
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from dcgrid_env import Scenario, __version__, make_scenario, scenario_hash
from dcgrid_env.agents.find import find_controller
from dcgrid_env.baselines import Controller, Placed, rollout
from dcgrid_env.metrics import Recorder

SPLIT = "test"
UNIT_EPISODES = 25
"""Episodes of a unit: enough for the batch to pay, few enough that an interruption costs little of a slow controller's
work. Units are cut alike however many processes there are, so that results do not hang on that."""

V_EDGES_PU = np.linspace(0.80, 1.20, 401)
"""Bins of the voltage histogram, p.u.; what lies beyond counts in the first or last."""


@dataclass(frozen=True)
class Unit:
    """What defines a unit's result."""

    scenario: str
    controller: str
    """As asked for."""
    first: int
    """Its first seed."""
    episodes: int
    scenario_hash: str
    controller_hash: str
    version: str
    """Of this package."""

    @property
    def seeds(self) -> range:
        """Seeds of its episodes."""
        return range(self.first, self.first + self.episodes)


CODE = (type, FunctionType, BuiltinFunctionType, ModuleType, np.ufunc)
"""What a controller may hold that is code and no parameter."""


class DoesNotApply(ValueError):
    """A controller refuses a scenario."""


def episode_records(
    scenario: str, controller: str, seeds: Sequence[int], metrics: Sequence[Mapping[str, float]], first: int = 0
) -> list[dict[str, Any]]:
    """One record for each episode, as results.json holds them; ``first`` is the number of the first."""
    return [
        {"scenario": scenario, "controller": controller, "episode": first + i, "seed": seed, **figures}
        for i, (seed, figures) in enumerate(zip(seeds, metrics, strict=True))
    ]


def plan(
    scenarios: Sequence[str], controllers: Sequence[str], episodes: int
) -> tuple[list[Unit], dict[tuple[str, str], str]]:
    """Units for all pairs, scenario by scenario, and why the rest have none, by (scenario, controller)."""
    units: list[Unit] = []
    failures: dict[tuple[str, str], str] = {}
    for name in scenarios:
        scenario = on_test_split(name)
        form = scenario_hash(scenario)
        for spec in controllers:
            try:
                identity = controller_hash(find_controller(spec, scenario), spec)
            except ValueError as error:
                failures[name, spec] = f"does not apply: {_line(error)}"
                continue
            except Exception as error:
                failures[name, spec] = f"failed: {type(error).__name__}: {_line(error)}"
                continue
            for first in range(0, episodes, UNIT_EPISODES):
                count = min(UNIT_EPISODES, episodes - first)
                units.append(Unit(name, spec, first, count, form, identity, __version__))
    return units, failures


@cache
def on_test_split(name: str) -> Scenario:
    """A preset on the test split."""
    return make_scenario(name, split=SPLIT)


def run(unit: Unit) -> dict[str, Any]:
    """The unit's record: what defines it, its episodes and voltages, or ``failure``, one line."""
    try:
        controller = find_controller(unit.controller, on_test_split(unit.scenario))
        recorder = rollout(on_test_split(unit.scenario), _Refusing(controller), unit.seeds)
    except DoesNotApply as error:
        return {"unit": asdict(unit), "failure": f"does not apply: {_line(error)}"}
    except (Exception, SystemExit) as error:  # whatever the user's code does, the others go on
        return {"unit": asdict(unit), "failure": f"failed: {type(error).__name__}: {_line(error)}"}
    metrics, counts = _figures(recorder, unit.episodes)
    return {
        "unit": asdict(unit),
        "observes": observed(controller, on_test_split(unit.scenario)),
        "episodes": episode_records(unit.scenario, unit.controller, unit.seeds, metrics, unit.first),
        "voltage": {"first_bin": int(np.flatnonzero(counts)[0]), "counts": np.trim_zeros(counts).tolist()},
    }


def observed(controller: Controller, scenario: Scenario) -> str:
    """What a controller is shown, in words."""
    scope = getattr(controller, "observe", scenario.observe)
    return f"{scope}, feeder's model" if isinstance(controller, Placed) else scope


def controller_hash(controller: Controller, spec: str = "") -> str:
    """SHA-256 of a fresh controller's parameters, of the file its class stands in and of the one that ``spec``, as the
    command line names it, is or begins with, 16 hexadecimal digits.
    """
    digest = hashlib.sha256(f"{type(controller).__module__}.{type(controller).__qualname__}".encode())
    with contextlib.suppress(TypeError, OSError):  # made without a file
        digest.update(Path(inspect.getfile(type(controller))).read_bytes())
    named = Path(spec if spec.endswith(".safetensors") else spec.rpartition(":")[0])
    if named.suffix in (".safetensors", ".py"):
        digest.update(named.read_bytes())
    _add(digest, controller, {})
    return digest.hexdigest()[:16]


class _Refusing:
    """A controller whose ValueError in ``reset`` means that it does not apply, and not that it failed."""

    def __init__(self, controller: Controller):
        self._controller = controller
        self.act = controller.act
        if isinstance(controller, Placed):
            self.place = controller.place
        if hasattr(controller, "observe"):
            self.observe = getattr(controller, "observe")  # noqa: B009 (no part of the protocol)

    def reset(self, env_info: Scenario) -> None:
        try:
            self._controller.reset(env_info)
        except ValueError as error:
            raise DoesNotApply(error) from error


def _figures(recorder: Recorder, lanes: int) -> tuple[list[dict[str, float]], np.ndarray]:
    """Metrics of each lane, and counts of all voltages in the bins of ``V_EDGES_PU``."""
    metrics, counts = [], np.zeros(len(V_EDGES_PU) - 1, dtype=np.int64)
    for lane in range(lanes):
        series = recorder.lane(lane)
        metrics.append(series.metrics())
        inside = np.clip(series.v_pu[1:, 1:], V_EDGES_PU[0], V_EDGES_PU[-1])
        counts += np.histogram(inside, V_EDGES_PU)[0]
    return metrics, counts


def _line(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return text if len(text) <= 300 else text[:297] + "..."


def _add(digest: Any, value: Any, seen: dict[int, tuple[int, Any]]) -> None:
    """Feed a parameter by value; of code its name, of what has no value to read the type alone.

    ``seen`` holds the place and the object of those fed before, by ``id``: one met again is fed as its place.
    """
    digest.update(f"{type(value).__qualname__}:".encode())
    if isinstance(value, str | bytes | int | float | complex | np.generic | PurePath | None):
        digest.update(f"{value!r};".encode())
    elif isinstance(value, CODE):
        digest.update(f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', '')};".encode())
    elif isinstance(value, tuple):
        _add_all(digest, value, seen)
    elif id(value) in seen:
        digest.update(f"{seen[id(value)][0]};".encode())
    else:
        seen[id(value)] = (len(seen), value)
        _add_held(digest, value, seen)


def _add_held(digest: Any, value: Any, seen: dict[int, tuple[int, Any]]) -> None:
    """Feed what an object holds: its items or figures, and its attributes."""
    if isinstance(value, Mapping):
        for key, held in value.items():
            digest.update(f"{key!r}=".encode())
            _add(digest, held, seen)
    elif isinstance(value, list):
        _add_all(digest, value, seen)
    elif isinstance(value, AbstractSet):
        _add_all(digest, sorted(value, key=repr), seen)
    elif isinstance(value, np.ndarray):
        digest.update(f"{value.shape}{value.dtype}".encode())
        if value.dtype == object:
            _add_all(digest, value.ravel().tolist(), seen)
        else:
            digest.update(value.tobytes())
    elif isinstance(value, MethodType):
        digest.update(f"{value.__qualname__};".encode())
        _add(digest, value.__self__, seen)
    elif hasattr(value, "tolist"):  # another library's array
        with contextlib.suppress(Exception):
            digest.update(f"{value.tolist()!r};".encode())
    for name, held in _attributes(value):
        digest.update(f".{name}=".encode())
        _add(digest, held, seen)


def _attributes(value: Any) -> list[tuple[str, Any]]:
    found = list(getattr(value, "__dict__", {}).items())
    for kind in type(value).__mro__:
        slots = vars(kind).get("__slots__", ())
        names = (slots,) if isinstance(slots, str) else slots
        found += [(name, getattr(value, name)) for name in names if name[:2] != "__" and hasattr(value, name)]
    return found


def _add_all(digest: Any, values: Sequence[Any], seen: dict[int, tuple[int, Any]]) -> None:
    digest.update(f"{len(values)};".encode())
    for value in values:
        _add(digest, value, seen)
