"""Mappings of plain data checked against the fields of a part: names and types, by pydantic, with the path of each."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cache
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from dcgrid_env.core.checked import UnknownFieldError
from dcgrid_env.scenario.errors import ScenarioError


def checked_mapping(scenario: Any, path: str, kind: type[Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a part that a mapping gives; their ranges, and what is no plain type, the part checks itself.

    Parameters
    ----------
    scenario, path
        The scenario's name and what leads to the part, for the message.
    kind
        The part's class, a dataclass.
    given
        Values by field.

    Raises
    ------
    ScenarioError
        For a name that is no field or a value of another type, naming path, value and remedy.
    """
    try:
        _model(kind).model_validate(dict(given))
    except ValidationError as error:
        wrong = error.errors()[0]
        where = ".".join([path, *(str(step) for step in wrong["loc"][:1])])
        if wrong["type"] == "extra_forbidden":
            names = [field.name for field in dataclasses.fields(kind)]
            raise ScenarioError(
                f"scenario {scenario!r}: {UnknownFieldError(path, where, ..., names).said(where)}"
            ) from None
        remedy = wrong["msg"][:1].lower() + wrong["msg"][1:]
        raise ScenarioError(f"scenario {scenario!r}: {where} is {wrong['input']!r}; {remedy}") from None
    return dict(given)


@cache
def _model(kind: type[Any]) -> type[BaseModel]:
    """A model of a part in which every field may be left out; fields that are objects take anything."""
    hints = get_type_hints(kind)
    fields: dict[str, Any] = {
        field.name: (hints[field.name] if _is_plain(hints[field.name]) else Any, None)
        for field in dataclasses.fields(kind)
    }
    config = ConfigDict(extra="forbid", strict=True, arbitrary_types_allowed=True, protected_namespaces=())
    return create_model(kind.__name__, __config__=config, **fields)


def _is_plain(hint: Any) -> bool:
    """Whether values of a type come as they are in plain data: numbers, texts, choices, and None beside them."""
    if get_origin(hint) in (Union, UnionType):
        return all(map(_is_plain, get_args(hint)))
    return hint in (int, float, str, bool, type(None)) or get_origin(hint) is Literal
