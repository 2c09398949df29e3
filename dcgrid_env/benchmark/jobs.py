"""Units of work: some test episodes of a scenario under a controller, and what is kept of them."""

from __future__ import annotations

import contextlib
import hashlib
import inspect
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env import Scenario, __version__, make_scenario, scenario_hash
from dcgrid_env.baselines import Controller, Placed, rollout
from dcgrid_env.baselines.user import find_controller
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
                identity = controller_hash(find_controller(spec, scenario))
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


def controller_hash(controller: Controller) -> str:
    """SHA-256 of a fresh controller's parameters and of the file its class stands in, 16 hexadecimal digits."""
    digest = hashlib.sha256(f"{type(controller).__module__}.{type(controller).__qualname__}".encode())
    with contextlib.suppress(TypeError, OSError):  # made without a file
        digest.update(Path(inspect.getfile(type(controller))).read_bytes())
    _add(digest, vars(controller) if hasattr(controller, "__dict__") else None, ())
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


def _add(digest: Any, value: Any, above: tuple[int, ...]) -> None:
    """Feed a parameter by value; of what holds itself, and of what has no value to read, the type alone."""
    digest.update(f"{type(value).__qualname__}:".encode())
    if id(value) in above:
        return
    above = (*above, id(value))
    if isinstance(value, str | bytes | int | float | complex | np.generic | None):
        digest.update(f"{value!r};".encode())
    elif isinstance(value, Mapping):
        for key, held in value.items():
            digest.update(f"{key!r}=".encode())
            _add(digest, held, above)
    elif isinstance(value, list | tuple):
        digest.update(f"{len(value)};".encode())
        for held in value:
            _add(digest, held, above)
    elif isinstance(value, np.ndarray):
        digest.update(f"{value.shape}{value.dtype}".encode())
        digest.update(value.tobytes() if value.dtype != object else repr(value).encode())
    elif hasattr(value, "__dict__") and not callable(value):
        _add(digest, vars(value), above)
