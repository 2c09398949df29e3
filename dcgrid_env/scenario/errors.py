"""The error of a scenario that cannot be, and how a part's error becomes one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from dcgrid_env.core.checked import FieldError


class ScenarioError(ValueError):
    """A scenario that cannot be; the message names the field, its value and what would do."""


@contextmanager
def located(scenario: Any, part: str) -> Iterator[None]:
    """Turn the FieldError of a part into a ScenarioError that names the scenario and the path of the field.

    Parameters
    ----------
    scenario
        The scenario's name.
    part
        What leads to the field, such as ``sensing``; "" for the scenario's own.
    """
    try:
        yield
    except FieldError as error:
        path = f"{part}.{error.name}" if part else str(error.name)
        raise ScenarioError(f"scenario {scenario!r}: {error.said(path)}") from None


class UnknownArgumentError(TypeError):
    """A name that is no field of a scenario."""

    def __init__(self, message: str, field: str):
        super().__init__(message)
        self.field = field

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (*self.args, self.field)
