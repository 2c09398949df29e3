"""Errors of an invalid scenario."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from dcgrid_env.core.checked import FieldError


class ScenarioError(ValueError):
    """Error of an invalid scenario; the message names the field, its value and what is allowed."""


@contextmanager
def located(scenario: object) -> Iterator[None]:
    """Turn a FieldError into a ScenarioError with the name of the scenario and the path of the field."""
    try:
        yield
    except FieldError as error:
        raise ScenarioError(f"scenario {scenario!r}: {error.said(error.name)}") from None


class UnknownArgumentError(TypeError):
    """Error of a name that is not a field of a scenario."""

    def __init__(self, message: str, field: str):
        super().__init__(message)
        self.field = field

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (*self.args, self.field)
