"""OpenDSS commands of the circuit that is equivalent to a GridLAB-D model."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dcgrid_env.apps.importers.gridlabd.glm_buses import Buses, Names
from dcgrid_env.apps.importers.gridlabd.glm_model import Model
from dcgrid_env.apps.importers.import_report import Report


@dataclass
class CircuitScript:
    """Commands of a circuit, as they are added.

    Attributes
    ----------
    model
        The GridLAB-D model.
    buses
        Its buses.
    names
        Names that are in use.
    report
        What became of each element.
    commands
        The commands.
    """

    model: Model
    buses: Buses
    names: Names
    report: Report
    commands: list[str] = field(default_factory=list)

    def new(self, kind: str, name: str, **properties: object) -> None:
        """Add an element with its properties in order."""
        words = [f"{key}={text(value)}" for key, value in properties.items()]
        self.commands.append(" ".join([f"New {kind}.{name}", *words]))


def text(value: object) -> str:
    """A property's value as OpenDSS reads it; matrices as their lower triangle."""
    if isinstance(value, np.ndarray):
        return "(" + " | ".join(" ".join(repr(float(v)) for v in row[: k + 1]) for k, row in enumerate(value)) + ")"
    if isinstance(value, str):
        return value
    if isinstance(value, Iterable):
        return "(" + " ".join(map(text, value)) + ")"
    return repr(value)


def line_to_line(volts: float) -> float:
    """Line-to-line voltage in kV of a line-to-neutral voltage in V."""
    return math.sqrt(3.0) * volts / 1000.0


def matrices(z: Any, c: Any) -> dict[str, Any]:
    """Properties of a line with these matrices per unit of its length."""
    return {"rmatrix": z.real, "xmatrix": z.imag, "cmatrix": c}
