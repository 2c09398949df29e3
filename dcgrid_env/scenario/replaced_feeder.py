"""A scenario on another feeder: a feeder that is not bundled brings its source voltage along."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dcgrid_env.core.digest import digest
from dcgrid_env.grid import is_bundled
from dcgrid_env.grid.random_feeders.family import RandomFeeders


def with_overrides(base: Any, overrides: Mapping[str, Any]) -> Any:
    """Return a scenario with some fields changed.

    A scenario's ``source_voltage_pu`` was chosen for its feeder. It therefore becomes that of the new feeder's file,
    unless the overrides contain it, or the feeder is bundled, random, or a variant of the scenario's feeder made in
    Python.
    """
    made = base.replace(**overrides)
    if "feeder" not in overrides or "source_voltage_pu" in overrides or not _brings_voltage(made.feeder, base.feeder):
        return made
    return made.replace(source_voltage_pu=made.feeder.v0_pu)


def _brings_voltage(feeder: Any, before: Any) -> bool:
    if isinstance(feeder, RandomFeeders) or is_bundled(feeder):
        return False
    if isinstance(before, RandomFeeders):
        return True
    if feeder.folder is None:
        return feeder.name != before.name
    return digest([("", feeder)]) != digest([("", before)])
