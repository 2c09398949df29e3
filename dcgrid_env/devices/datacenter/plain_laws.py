"""Clock laws as plain data: a name, or a mapping with the key ``law`` and the law's parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from dcgrid_env.core.checked import Plain
from dcgrid_env.devices.datacenter.clock_law import LinearDvfs
from dcgrid_env.devices.datacenter.power_cap import PowerCapDvfs
from dcgrid_env.devices.datacenter.prefill_decode import PrefillDecodeDvfs

CLOCK_LAWS: dict[str, type[Any]] = {
    "linear": LinearDvfs,
    "prefill-decode": PrefillDecodeDvfs,
    "power-cap": PowerCapDvfs,
}
"""Clock laws by name."""


def clock_law(value: object) -> Any:
    """Return the law for plain data; any other value unchanged.

    ValueError, with the allowed values, for an unknown law or parameter, or an invalid value.
    """
    law, parameters = value, {}
    if isinstance(value, Mapping):
        parameters = dict(value)
        law = parameters.pop("law", None)
    elif not isinstance(value, str):
        return value
    if not isinstance(law, str) or law not in CLOCK_LAWS:
        names = ", ".join(map(repr, CLOCK_LAWS))
        raise ValueError(f"give {names}, or a mapping with the key 'law' that is one of them")
    fields = [field.name for field in dataclasses.fields(CLOCK_LAWS[law])]
    for key in parameters:
        if key not in fields:
            raise ValueError(f"law {law!r} has no parameter {key!r}; there are {', '.join(fields) or 'none'}")
    return CLOCK_LAWS[law](**parameters)


def plain_law(law: Any) -> Plain:
    """Return the plain form of a law; a custom law unchanged."""
    for name, kind in CLOCK_LAWS.items():
        if type(law) is kind:
            return {"law": name, **dataclasses.asdict(law)} if dataclasses.fields(kind) else name
    return law
