"""Which groups of devices can stand in a scenario together: what they call their own must be theirs alone."""

from __future__ import annotations

from typing import Any

from dcgrid_env.core.checked import FieldError

NAMES_OF_THE_GRID = (
    "v_deviation", "v_change", "p", "q", "q_limit", "r", "x", "voltage", "violation", "effort", "step", "loss",
    "unbalance", "switching", "ramp_excess", "voltage_step_excess", "overload", "loading",
)  # fmt: skip
"""Fields and cost terms that every agent has, which no device may call its own."""


def check_groups(devices: tuple[Any, ...], horizon: int, dt_s: float) -> None:
    """Raise FieldError for two groups of a kind or of one source, or a name that is the grid's or another group's."""
    kinds = [device.kind for device in devices]
    for kind in kinds:
        if kinds.count(kind) > 1:
            raise _refused(f"more than one group is of kind {kind!r}; give one, with a rating for each slot")
    for source in ("workload", "injection"):
        if sum(device.input == source for device in devices) > 1:
            raise _refused(f"more than one group is driven by {source}; give one, with a rating for each slot")
    terms: dict[str, str] = {}
    for device in devices:
        own = [term.name for term in device.cost_terms(horizon, dt_s)]
        for name in (*own, *(field.name for field in device.fields(horizon, dt_s))):
            if name in NAMES_OF_THE_GRID:
                raise _refused(f"{device.kind!r} calls something {name!r}, which is the grid's; rename it")
        for name in own:
            if terms.setdefault(name, device.kind) != device.kind:
                raise _refused(f"{terms[name]!r} and {device.kind!r} both have a cost term {name!r}; rename one")


def _refused(remedy: str) -> FieldError:
    return FieldError("Scenario", "devices", ..., f"cannot be: {remedy}")
