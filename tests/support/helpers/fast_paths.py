"""Steps with and without the fast paths, and fields that a contributor might add to a class.

This is the one place in the tests that lists the fast paths. Tests of their coverage compare results.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from dcgrid_env.devices.datacenter import datacenter
from dcgrid_env.engine.cost import difference, reward
from dcgrid_env.engine.physics import dynamics, grid_pass
from dcgrid_env.engine.physics.actions import action_layout
from dcgrid_env.engine.simulation import Simulation

NAME = "made_up"
"""Name of the field that tests add."""


@contextmanager
def general_path() -> Iterator[None]:
    """Take no fast path in simulations that begin in this context."""
    with pytest.MonkeyPatch.context() as patch:
        for module, names, answer in (
            (dynamics, ("_grid_pass",), None),
            (reward, ("_is_from_figures",), False),
            (difference, ("has_kernel",), False),
            (datacenter, ("_is_compiled",), False),
        ):
            for name in names:
                patch.setattr(module, name, lambda *_, answer=answer: answer, raising=False)
        yield


def fast_paths(scenario: Any, n_env: int = 1) -> set[str]:
    """Return the fast paths that the first steps of a scenario take."""
    taken: set[str] = set()
    with pytest.MonkeyPatch.context() as patch:
        for module, name in (
            (grid_pass, "grid_pass"),
            (datacenter, "serve_linearly"),
        ):
            patch.setattr(module, name, _noting(taken, name, getattr(module, name)))
        steps_of(Simulation(altered(scenario), n_env), steps=2)
    return taken


def _noting(taken: set[str], name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    def noted(*args: Any) -> Any:
        taken.add(name)
        return function(*args)

    return noted


def steps_of(simulation: Simulation, steps: int) -> list[Any]:
    """Return the snapshots of an episode from its reset on; actions are random and partly beyond their bounds."""
    rng, n = np.random.default_rng(0), action_layout(simulation.scenario).n
    simulation.reset(range(simulation.n_env))
    snapshots = [simulation.now]
    for _ in range(steps):
        simulation.step(rng.uniform(-1.2, 1.2, (simulation.n_env, n)))
        snapshots.append(simulation.now)
    return snapshots


def both_ways(scenario: Any, n_env: int = 1, steps: int = 3) -> tuple[list[Any], list[Any]]:
    """Return the snapshots of the same steps with fast paths where they fit, and without."""
    fast = steps_of(Simulation(scenario, n_env), steps)
    with general_path():
        return fast, steps_of(Simulation(altered(scenario), n_env), steps)


def assert_same(fast: Any, general: Any, path: str = "") -> None:
    """Assert that all arrays in two nested tuples agree to the rounding of floating-point numbers."""
    assert type(fast) is type(general), path
    if isinstance(fast, np.ndarray):
        np.testing.assert_allclose(fast, general, rtol=1e-9, atol=1e-10, err_msg=path)
    elif isinstance(fast, tuple | list):
        for i, (a, b) in enumerate(zip(fast, general, strict=True)):
            assert_same(a, b, f"{path}.{getattr(fast, '_fields', range(len(fast)))[i]}")


def results(snapshots: list[Any]) -> list[Any]:
    """Return all arrays that change from step to step."""
    return [(*snapshot[4:], snapshot.transition.costs) for snapshot in snapshots]


def add_field(patch: pytest.MonkeyPatch, kind: type[Any], default: Any = 0.0) -> None:
    """Add a field to a dataclass, as if it were in its source; existing objects have its default."""
    made = dataclasses.make_dataclass("Made", [(NAME, object, dataclasses.field(default=default))])
    fields = {**kind.__dataclass_fields__, NAME: made.__dataclass_fields__[NAME]}
    patch.setattr(kind, "__dataclass_fields__", fields)
    patch.setattr(kind, NAME, default, raising=False)


def edit(patch: pytest.MonkeyPatch, kind: type[Any], name: str, function: Callable[..., Any]) -> None:
    """Replace a method of a class by a function as if it were in the class's source."""
    function.__code__ = function.__code__.replace(co_name=name, co_qualname=f"{kind.__qualname__}.{name}")
    patch.setattr(kind, name, function)


def altered(record: Any, path: str = "", value: Any = None) -> Any:
    """Return a copy of a dataclass without cached results, with another value at a path such as ``sensing.noise_pu``.

    Positions in tuples are numbers: ``devices.0.buses``. Nothing is checked.
    """
    if isinstance(record, tuple):
        first, _, rest = path.partition(".")
        i = int(first)
        return (*record[:i], altered(record[i], rest, value), *record[i + 1 :])
    copy = object.__new__(type(record))
    for field in dataclasses.fields(record):
        object.__setattr__(copy, field.name, getattr(record, field.name))
    if path:
        first, _, rest = path.partition(".")
        object.__setattr__(copy, first, altered(getattr(record, first), rest, value) if rest else value)
    return copy
