"""Sags of a scenario as plain data: the name of a recorded sequence, or a list of mappings of the fields of Sag."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from dcgrid_env.core.checked import FieldError
from dcgrid_env.devices.ride_through.sags import SAG_SEQUENCES, Sag
from dcgrid_env.scenario.errors import ScenarioError


def sags_from_plain(value: object) -> Any:
    """Return sags, made from mappings where needed; any other value unchanged. ScenarioError for an invalid one."""
    if isinstance(value, str):
        if value not in SAG_SEQUENCES:
            raise ScenarioError(f"sags is {value!r}; choose one of {', '.join(SAG_SEQUENCES)}, or give a list of sags")
        return SAG_SEQUENCES[value]()
    if isinstance(value, Sag | Mapping):
        value = (value,)
    return tuple(_sag(i, sag) for i, sag in enumerate(value)) if isinstance(value, list | tuple) else value


def sag_to_plain(sag: Sag) -> dict[str, Any]:
    """Return the plain form of a sag: a mapping of its fields without those at their default."""
    plain: dict[str, Any] = {name: list(getattr(sag, name)) for name in ("begin_s", "duration_s", "retained_pu")}
    return plain if sag.since == "episode" else {**plain, "since": sag.since}


def _sag(i: int, given: object) -> Any:
    if not isinstance(given, Mapping):
        return given
    keys = [field.name for field in dataclasses.fields(Sag)]
    for key in (*given, *(name for name in keys[:3] if name not in given)):
        if key not in keys or key not in given:
            wrong = "is no key" if key not in keys else "is missing"
            raise ScenarioError(f"sags[{i}]: {key!r} {wrong}; give {', '.join(keys)}, the last if need be")
    try:
        return Sag(**{key: v.tolist() if isinstance(v, np.ndarray) else v for key, v in given.items()})
    except FieldError as error:
        raise ScenarioError(f"sags[{i}]: {error.said(error.name)}") from None
