"""The settings of a feature of data centres out of their plain form, a mapping of their fields, and back."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from dcgrid_env.core.checked import FieldError


def settings_of(field: str, kind: type[Any], value: Any) -> Any:
    """The settings that a mapping stands for; any other value as it is.

    FieldError, with the field of the data centres in front, for a key that there is not or a value that cannot be.
    """
    if not isinstance(value, Mapping):
        return value
    there = [own.name for own in dataclasses.fields(kind)]
    for name in value:
        if name not in there:
            raise FieldError("DataCenters", f"{field}.{name}", ..., f"is no field; there are {', '.join(there)}")
    try:
        return kind(**value)
    except FieldError as error:
        raise FieldError("DataCenters", f"{field}.{error.name}", error.value, error.remedy) from None


def plain_settings(settings: Any) -> dict[str, Any]:
    """The plain form: a mapping of the fields that are not at their default."""
    given = ((field, getattr(settings, field.name)) for field in dataclasses.fields(settings))
    return {field.name: value for field, value in given if value != field.default}
