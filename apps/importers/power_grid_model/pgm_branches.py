"""Branches of power-grid-model's components in per unit, as its documentation defines them (sections Components and
Transformer model)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dcgrid_env.apps.importers.bus_branch import Branch, ClosedSwitch
from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.power_grid_model.pgm_data import Data

BASE_MVA = 1.0
"""power-grid-model's base power, MVA."""
_BASE_VA = 1e6
_SQRT3 = math.sqrt(3.0)


def read_lines(data: Data, rows: dict[int, int], u_rated: np.ndarray, frequency_hz: float) -> list[Branch]:
    """Lines: series impedance, and half of the charging at either end."""
    branches = []
    for line in data.get("line", ()):
        u = u_rated[rows[int(line["from_node"])]]
        base_ohm = u**2 / _BASE_VA
        loss = _or(line["tan1"], 0.0)
        charging = 2.0 * math.pi * frequency_hz * float(line["c1"]) * complex(loss, 1.0) * base_ohm / 2.0
        limit = float(line["i_n"])
        rating = limit * _SQRT3 * u / _BASE_VA if math.isfinite(limit) else math.nan
        z_pu = complex(line["r1"], line["x1"]) / base_ohm
        branches.append(_branch("line", line, rows, z_pu, charging, 1.0, 0.0, rating))
    return branches


def read_generic_branches(data: Data, rows: dict[int, int], u_rated: np.ndarray) -> list[Branch]:
    """Branches of free parameters, given at their to side."""
    branches = []
    for one in data.get("generic_branch", ()):
        u = u_rated[rows[int(one["to_node"])]]
        base_ohm = u**2 / _BASE_VA
        charging = complex(_or(one["g1"], 0.0), _or(one["b1"], 0.0)) * base_ohm / 2.0
        sn = float(one["sn"])
        z_pu, ratio = complex(one["r1"], one["x1"]) / base_ohm, _or(one["k"], 1.0)
        shift = math.degrees(_or(one["theta"], 0.0))
        rating = sn / _BASE_VA if math.isfinite(sn) and sn > 0 else math.nan
        branches.append(_branch("generic_branch", one, rows, z_pu, charging, ratio, shift, rating))
    return branches


def read_transformers(data: Data, rows: dict[int, int], u_rated: np.ndarray) -> list[Branch]:
    """Transformers: short-circuit impedance and half of the magnetising admittance at either end, taps within
    limits."""
    branches = []
    for one in data.get("transformer", ()):
        u_from, u_to = (float(u_rated[rows[int(one[end])]]) for end in ("from_node", "to_node"))
        u1, u2, uk, pk = _tapped(one)
        sn, base_ohm = float(one["sn"]), u_to**2 / _BASE_VA
        z_ohm, r_ohm = abs(uk) * u2**2 / sn, pk * u2**2 / sn**2
        x_ohm = math.copysign(math.sqrt(max(z_ohm**2 - r_ohm**2, 0.0)), uk)
        y_siemens, g_siemens = float(one["i0"]) * sn / u2**2, float(one["p0"]) / u2**2
        magnetising = complex(g_siemens, -math.sqrt(max(y_siemens**2 - g_siemens**2, 0.0))) * base_ohm / 2.0
        ratio = (u1 / u2) / (u_from / u_to)
        z_pu, rating = complex(r_ohm, x_ohm) / base_ohm, sn / _BASE_VA * u_to / u2
        shift = 30.0 * int(one["clock"])
        branches.append(_branch("transformer", one, rows, z_pu, magnetising, ratio, shift, rating))
    return branches


def read_links(data: Data, rows: dict[int, int], report: Report) -> list[ClosedSwitch]:
    """Links that are closed at both ends, as switches."""
    switches = []
    for one in data.get("link", ()):
        name = f"link {int(one['id'])}"
        if one["from_status"] and one["to_status"]:
            switches.append(ClosedSwitch(name, rows[int(one["from_node"])], rows[int(one["to_node"])]))
        else:
            report.add("nothing lost", "link", str(int(one["id"])), "open: it is left out")
    return switches


def _branch(
    kind: str, one: Any, rows: dict[int, int], z_pu: complex, half: complex, ratio: float, shift: float, rating: float
) -> Branch:
    ends, closed = (rows[int(one["from_node"])], rows[int(one["to_node"])]), (one["from_status"], one["to_status"])
    name = str(int(one["id"]))
    return Branch(kind, name, *ends, z_pu, half, half, ratio, shift, rating, bool(closed[0]), bool(closed[1]))


def _tapped(one: Any) -> tuple[float, float, float, float]:
    """Rated voltages, V, short-circuit voltage, p.u., and loss, W, at the tap position, which stays within its
    limits."""
    u1, u2, uk, pk = (float(one[name]) for name in ("u1", "u2", "uk", "pk"))
    least, most = int(one["tap_min"]), int(one["tap_max"])
    unset = np.iinfo(one["tap_pos"].dtype).min
    middle = 0 if one["tap_nom"] == unset else int(one["tap_nom"])
    position = middle if one["tap_pos"] == unset else int(one["tap_pos"])
    position = min(max(position, min(least, most)), max(least, most))
    step = (1 if most > least else -1) * (position - middle) * _or(one["tap_size"], 0.0)
    uk = _at_tap(position, least, most, middle, uk, _or(one["uk_min"], uk), _or(one["uk_max"], uk))
    pk = _at_tap(position, least, most, middle, pk, _or(one["pk_min"], pk), _or(one["pk_max"], pk))
    return (u1 + step, u2, uk, pk) if int(one["tap_side"]) == 0 else (u1, u2 + step, uk, pk)


def _at_tap(
    position: int, least: int, most: int, middle: int, value: float, value_least: float, value_most: float
) -> float:
    """A figure between those at the lowest, the nominal and the highest tap, along straight lines."""
    if position <= max(middle, most) and position >= min(middle, most):
        return value if most == middle else value + (value_most - value) * (position - middle) / (most - middle)
    return value if least == middle else value + (value_least - value) * (position - middle) / (least - middle)


def _or(value: Any, default: float) -> float:
    return default if np.isnan(value) else float(value)
