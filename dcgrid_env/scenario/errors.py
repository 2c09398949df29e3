"""Error of an invalid scenario, and conversion of a part's error to it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from dcgrid_env.core.checked import FieldError


class ScenarioError(ValueError):
    """Error of an invalid scenario; the message names the field, its value and what is allowed."""


@contextmanager
def located(scenario: object, part: str) -> Iterator[None]:
    """Turn the FieldError of a part into a ScenarioError that names the scenario and the path of the field.

    Parameters
    ----------
    scenario
        The scenario's name.
    part
        Path to the field, such as ``sensing``; "" for fields of the scenario itself.
    """
    try:
        yield
    except FieldError as error:
        path = f"{part}.{error.name}" if part else str(error.name)
        raise ScenarioError(f"scenario {scenario!r}: {error.said(path)}") from None


class UnknownArgumentError(TypeError):
    """Error of a name that is not a field of a scenario."""

    def __init__(self, message: str, field: str):
        super().__init__(message)
        self.field = field

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (*self.args, self.field)
