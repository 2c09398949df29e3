"""Impedance and capacitance of GridLAB-D's lines per mile, from conductors and spacing or from matrices.

Carson's equations are simplified as in GridLAB-D, after Kersting, "Distribution System Modeling and Analysis".
Conductors other than phases (neutrals, concentric strands and tape shields) are eliminated as grounded at both ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.apps.importers.gridlabd.glm_model import Model, wrong
from dcgrid_env.apps.importers.gridlabd.glm_text import GlmObject
from dcgrid_env.apps.importers.import_report import Report

Matrix = NDArray[Any]
_R_EARTH, _X_EARTH = 0.00158836, 0.00202237
"""Resistance of the earth return and factor of the reactance, Ohm/mile per Hz."""
_EARTH_OHM_M = 100.0
_PERMITTIVITY, _CABLE_PERMITTIVITY = 0.01424, 0.0142
"""Permittivity of air and, as GridLAB-D has it for cables, of free space, microfarad/mile."""
_OVERHEAD = ("overhead_line_conductor",)
_CABLE = ("underground_line_conductor",)
_TRIPLEX = ("triplex_line_conductor",)


@dataclass(frozen=True)
class Wire:
    """A conductor: resistance in Ohm/mile and geometric mean radius in ft."""

    resistance: float
    gmr: float


def line_matrices(
    model: Model, line: GlmObject, phases: str, frequency_hz: float, report: Report
) -> tuple[Matrix, Matrix]:
    """Impedance in Ohm/mile and capacitance in nF/mile over the phases of a line, ``"12"`` for a triplex line."""
    triplex = line.kind == "triplex_line"
    kind = "triplex_line_configuration" if triplex else "line_configuration"
    config = model.reference(line, "configuration", kind)
    numbers = [{"A": 1, "B": 2, "C": 3, "1": 1, "2": 2}[phase] for phase in phases]
    if any(model.value(config, f"z{k}{k}", "impedance per length", 0.0) for k in numbers):
        z = _given_matrix(model, config, numbers, "z", "impedance per length")
        return z, np.real(_given_matrix(model, config, numbers, "c", "capacitance per length"))
    if triplex:
        return _triplex(model, config, frequency_hz), np.zeros((2, 2))
    spacing = model.reference(config, "spacing", "line_spacing")
    has_neutral = "N" in model.phases(line) and "conductor_N" in config.properties
    places = phases + ("N" if has_neutral else "")
    d = _distances(model, spacing, places)
    apart = [f"{places[i]}{places[j]}" for i, j in zip(*np.nonzero(np.triu(d == 0.0, 1)), strict=True)]
    if apart:
        text = f"no coupling between {', '.join(apart)}, as in GridLAB-D: distances of 0 in line_spacing {spacing.name}"
        report.add("nothing lost", line.kind, line.name, text)
    if line.kind == "overhead_line":
        return _overhead(model, config, spacing, places, d, len(phases), frequency_hz)
    return _underground(model, config, places, d, len(phases), frequency_hz)


def _given_matrix(model: Model, config: GlmObject, numbers: list[int], letter: str, quantity: str) -> Matrix:
    m = np.array([[model.value(config, f"{letter}{i}{j}", quantity, 0.0) for j in numbers] for i in numbers])
    if not np.allclose(m, m.T, rtol=1e-3, atol=0.0):
        wrong(config, f"{letter}{numbers[0]}{numbers[1]}", "makes the matrix asymmetric; set both entries alike")
    return 0.5 * (m + m.T)


def carson(wires: list[Wire], distances: Matrix, frequency_hz: float) -> Matrix:
    """Impedance matrix of parallel conductors with earth return, Ohm/mile.

    Parameters
    ----------
    wires
        The conductors.
    distances
        Distance between each two, ft; 0 for those without coupling. The diagonal is not used.
    frequency_hz
        System frequency, Hz.
    """
    distances = np.array(distances, float)
    np.fill_diagonal(distances, [wire.gmr for wire in wires])
    added = math.log(_EARTH_OHM_M / frequency_hz) / 2.0 + 7.6786
    coupled = distances > 0.0
    reactance = _X_EARTH * frequency_hz * (added - np.log(np.where(coupled, distances, 1.0)))
    return np.diag([wire.resistance for wire in wires]) + coupled * (_R_EARTH * frequency_hz + 1j * reactance)


def reduced(m: Matrix, kept: int) -> Matrix:
    """A matrix without the conductors after the first ``kept``, which are grounded."""
    if kept == len(m):
        return m
    return m[:kept, :kept] - m[:kept, kept:] @ np.linalg.solve(m[kept:, kept:], m[kept:, :kept])


def _distances(model: Model, spacing: GlmObject, places: str) -> Matrix:
    """Distance between each two conductors, ft; GridLAB-D's default is 0."""
    size = len(places)
    d = np.ones((size, size))
    for i in range(size):
        for j in range(i + 1, size):
            name = f"distance_{places[i]}{places[j]}"
            d[i, j] = d[j, i] = model.real(spacing, name, "length", 0.0)
            if d[i, j] < 0.0:
                wrong(spacing, name, "must not be negative")
    return d


def _overhead(
    model: Model, config: GlmObject, spacing: GlmObject, places: str, d: Matrix, kept: int, frequency_hz: float
) -> tuple[Matrix, Matrix]:
    conductors = [model.reference(config, f"conductor_{place}", *_OVERHEAD) for place in places]
    wires = [
        Wire(
            model.positive(one, "resistance", "impedance per length"),
            model.positive(one, "geometric_mean_radius", "length"),
        )
        for one in conductors
    ]
    z = reduced(carson(wires, d, frequency_hz), kept)
    diameters = np.array([model.real(one, "diameter", "diameter", 0.0) for one in conductors])
    heights = np.array([model.real(spacing, f"distance_{place}E", "length", 0.0) for place in places])
    if diameters.min() <= 0.0 or heights.min() <= 0.0:
        return z, np.zeros((kept, kept))
    images = np.sqrt(d**2 + 4.0 * np.outer(heights, heights))
    images[d == 0.0] = 1.0  # no coupling
    d = np.where(d == 0.0, 1.0, d)
    np.fill_diagonal(d, diameters / 24.0)
    np.fill_diagonal(images, 2.0 * heights)
    potentials = np.log(images / d) / (2.0 * math.pi * _PERMITTIVITY)
    return z, 1e3 * np.linalg.inv(reduced(potentials, kept))


def _underground(
    model: Model, config: GlmObject, places: str, d: Matrix, kept: int, frequency_hz: float
) -> tuple[Matrix, Matrix]:
    """Cables with concentric neutral strands, with a tape shield, or with neither."""
    conductors = [model.reference(config, f"conductor_{place}", *_CABLE) for place in places]
    wires = [
        Wire(
            model.positive(one, "conductor_resistance", "impedance per length"),
            model.positive(one, "conductor_gmr", "length"),
        )
        for one in conductors
    ]
    screens = [(k, *screen) for k, one in enumerate(conductors[:kept]) if (screen := _screen(model, one))]
    placed = [*range(len(wires)), *(k for k, *_ in screens)]
    d = d[np.ix_(placed, placed)]
    for row, (k, _, radius, _) in enumerate(screens, start=len(wires)):
        d[k, row] = d[row, k] = radius
    z = carson([*wires, *(wire for _, wire, *_ in screens)], d, frequency_hz)
    c = np.zeros((kept, kept))
    for k, _, _, nanofarads in screens:
        c[k, k] = nanofarads
    return reduced(z, kept), c


def _screen(model: Model, cable: GlmObject) -> tuple[Wire, float, float] | None:
    """Screen of a cable as one conductor, its radius in ft, and its capacitance to the phase in nF/mile."""
    inner_ft = model.real(cable, "conductor_diameter", "diameter", 0.0) / 24.0
    permittivity = model.real(cable, "insulation_relative_permitivitty", "ratio", 1.0)
    charge = 2e3 * math.pi * _CABLE_PERMITTIVITY * permittivity
    shield_ft = model.real(cable, "shield_gmr", "length", 0.0)
    if shield_ft > 0.0:
        wire = Wire(model.real(cable, "shield_resistance", "impedance per length", 0.0), shield_ft)
        diameter, thickness = (
            model.real(cable, f"shield_{name}", "diameter", 0.0) for name in ("diameter", "thickness")
        )
        radius = (diameter - thickness) / 24.0 if diameter > 0.0 else shield_ft
        return wire, shield_ft, charge / math.log(radius / inner_ft) if 0.0 < inner_ft < radius else 0.0
    strands = model.real(cable, "neutral_strands", "ratio", 0.0)
    gmr = model.real(cable, "neutral_gmr", "length", 0.0)
    if strands <= 0.0 or gmr <= 0.0:
        return None
    diameter = model.positive(cable, "neutral_diameter", "diameter")
    radius = (model.positive(cable, "outer_diameter", "diameter") - diameter) / 24.0
    if not radius > 0.0:
        wrong(cable, "outer_diameter", "must be larger than neutral_diameter")
    wire = Wire(
        model.positive(cable, "neutral_resistance", "impedance per length") / strands,
        (gmr * strands * radius ** (strands - 1.0)) ** (1.0 / strands),
    )
    between = 0.0
    if 0.0 < inner_ft < radius:
        between = math.log(radius / inner_ft) - math.log(strands * diameter / 24.0 / radius) / strands
    return wire, radius, charge / between if between > 0.0 else 0.0


def _triplex(model: Model, config: GlmObject, frequency_hz: float) -> Matrix:
    conductors = [model.reference(config, f"conductor_{place}", *_TRIPLEX) for place in "12N"]
    wires = [
        Wire(
            model.positive(one, "resistance", "impedance per length"),
            model.positive(one, "geometric_mean_radius", "length"),
        )
        for one in conductors
    ]
    diameter = model.real(config, "diameter", "diameter", 0.0) / 12.0
    thickness = model.real(config, "insulation_thickness", "diameter", 0.0) / 12.0
    if not diameter + thickness > 0.0:
        wrong(config, "diameter", "must be positive, or insulation_thickness")
    d = np.full((3, 3), diameter + thickness)
    d[0, 1] = d[1, 0] = diameter + 2.0 * thickness
    return reduced(carson(wires, d, frequency_hz), 2)
