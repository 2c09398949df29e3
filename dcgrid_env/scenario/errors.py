"""The error of a scenario that cannot be, and how a part's error becomes one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from dcgrid_env.core.checked import FieldError


class ScenarioError(ValueError):
    """A scenario that cannot be; the message names the field, its value and what would do."""


@contextmanager
def located(scenario: Any, part: str, flat: Mapping[str, str]) -> Iterator[None]:
    """Turn the FieldError of a part into a ScenarioError that names the scenario and the field as it was given.

    Parameters
    ----------
    scenario
        The scenario's name.
    part
        What leads to the field, such as ``sensing``; "" for the scenario's own.
    flat
        Flat names by the fields that were given by them.
    """
    try:
        yield
    except FieldError as error:
        field, dot, rest = str(error.name).partition(".")
        path = flat.get(field) or (f"{part}.{field}" if part else field)
        raise ScenarioError(f"scenario {scenario!r}: {error.said(f'{path}{dot}{rest}')}") from None


class UnknownArgumentError(TypeError):
    """A name that is no field of a scenario."""

    def __init__(self, message: str, field: str):
        super().__init__(message)
        self.field = field

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (*self.args, self.field)
