"""The phases of its bus that a device is connected to, on a three-phase feeder."""

from __future__ import annotations

from typing import Any

from dcgrid_env.core.checked import refuse

PHASES = ("a", "b", "c", "ab", "bc", "ac", "abc")
"""Phases that a device can be connected to, each to ground; its power is shared equally among them."""
Phases = str | tuple[str, ...]
"""One text of ``PHASES`` for all devices of a group, or one for each."""


def check_phases(owner: Any, n: int) -> None:
    """Raise FieldError unless the field ``phases`` of a group is None or says the phases of ``n`` devices."""
    value = owner.phases
    each = value if isinstance(value, tuple) else (value,) * n
    if value is not None and (len(each) != n or not all(phases in PHASES for phases in each)):
        raise refuse(owner, "phases", f"give one of {', '.join(PHASES)}, or one for each of the {n} devices")


def phases_of(device: Any) -> tuple[str | None, ...]:
    """The phases of each slot of a group; None where it is connected to all that its bus has."""
    value = getattr(device, "phases", None)
    return value if isinstance(value, tuple) else (value,) * device.count
