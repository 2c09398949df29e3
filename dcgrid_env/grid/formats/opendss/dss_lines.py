"""Lines and switches of an OpenDSS circuit: their matrices over the whole length, from OpenDSS's own admittances."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.grid.formats.opendss.dss_circuit import DssCircuit
from dcgrid_env.grid.formats.opendss.import_report import Report
from dcgrid_env.grid.formats.opendss.joints import Joint, phases_of
from dcgrid_env.grid.three_phase_tables import Matrix

_ROUNDING = 1e-12  # relative, of what an inverse leaves in place of 0
_SWITCH_B_US = 1e-3
"""Charging that a switch is not thought to have: OpenDSS's own default is 2e-4 microsiemens."""
_NO_PHASE = math.nan
_METRES = {"mi": 1609.344, "kft": 304.8, "km": 1000.0, "m": 1.0, "ft": 0.3048, "in": 0.0254, "cm": 0.01, "mm": 0.001}


def read_lines(circuit: DssCircuit, report: Report) -> list[Joint]:
    """The lines and switches that can be represented; the others stand in the report."""
    found = [_line(circuit, report, name) for name in circuit.names("line")]
    return _side_by_side([line for line in found if line is not None], report)


def _line(circuit: DssCircuit, report: Report, name: str) -> Joint | None:
    circuit.activate("line", name)
    first, second = circuit.terminals()
    wrong = _wrong_ends(first.nodes, second.nodes)
    opened = [all(phases) for phases in circuit.open_conductors()]
    if any(any(phases) for phases in circuit.open_conductors()) and not any(opened):
        wrong = "some of its phases are open; open all of them, or leave those phases out"
    if wrong:
        report.add("refused", "line", name, wrong)
        return None
    with circuit.closed():
        y = circuit.admittance()
    n = len(first.nodes)
    z = np.linalg.inv(-y[:n, n:])
    shunt = y[:n, :n] + y[:n, n:]
    noise = _ROUNDING * np.abs(y[:n, n:]).max()
    if np.abs(shunt.real).max() > noise + 1e-9 * np.abs(shunt).max():
        report.add("lost", "line", name, "its shunt conductance is left out")
    b_us = 2e6 * np.where(np.abs(shunt.imag) > noise, shunt.imag, 0.0)  # half of it stands at this end
    phases = phases_of(first.nodes)
    turned = np.argsort(first.nodes)
    z, b_us = z[np.ix_(turned, turned)], b_us[np.ix_(turned, turned)]
    ends = (first.bus, second.bus)
    joint = Joint("phase_line", name, ends, phases, not any(opened), _line_values(circuit, z, b_us, phases))
    return _as_switch(circuit, report, joint, z, b_us)


def _wrong_ends(first: tuple[int, ...], second: tuple[int, ...]) -> str:
    if not (set(first) | set(second)) <= {1, 2, 3}:
        return "a conductor is no phase (nodes 1, 2, 3): reduce its neutral, with Reduce=yes of its LineGeometry"
    if len(set(first)) < len(first):
        return f"two conductors stand at one node, {'.'.join(map(str, first))}"
    if first != second:
        return f"its phases change from {'.'.join(map(str, first))} to {'.'.join(map(str, second))}"
    return ""


def _line_values(circuit: DssCircuit, z: NDArray[np.complex128], b_us: Any, phases: str) -> dict[str, Any]:
    unit = _METRES.get(circuit.text("units").lower(), math.nan)
    matrices = {"r_ohm": z.real, "x_ohm": z.imag, "b_us": b_us}
    length_m = rounded(circuit.figure("length") * unit)
    return {"length_m": length_m, **{key: matrix_of(value, phases) for key, value in matrices.items()}}


def matrix_of(values: Any, phases: str) -> Matrix:
    """Figures over the phases that exist as three rows of three, symmetric and rounded to 12 digits."""
    least = _ROUNDING * float(np.abs(values).max())
    full = np.full((3, 3), _NO_PHASE)
    at = ["abc".index(phase) for phase in phases]
    full[np.ix_(at, at)] = np.where(np.abs(values) > least, 0.5 * (values + values.T), 0.0)
    return tuple(tuple(rounded(value) for value in row) for row in full.tolist())


def rounded(value: float) -> float:
    """A figure to 12 significant digits: the rounding of an inverse is not kept."""
    return float(f"{value:.12g}")


def _as_switch(circuit: DssCircuit, report: Report, line: Joint, z: Any, b_us: Any) -> Joint:
    """A switch in place of a line that is one, or that is open; the report says what it has lost."""
    one = z[0, 0]
    alike = np.allclose(z, one * np.eye(len(z)), rtol=0.0, atol=1e-9 * abs(one))
    bare = alike and float(np.abs(b_us).max()) < _SWITCH_B_US
    if line.closed and not (circuit.yes("switch") and bare):
        report.add("taken", "line", line.name, "in lines.csv")
        return line
    mean = complex(np.diag(z).mean())
    values = {"state": "closed" if line.closed else "open", "r_ohm": rounded(mean.real), "x_ohm": rounded(mean.imag)}
    values = {key: 0.0 if isinstance(v, float) and abs(v) < _ROUNDING * abs(mean) else v for key, v in values.items()}
    report.add("taken", "line", line.name, "in switches.csv" if bare else "open: in switches.csv, mean impedance alone")
    return replace(line, kind="switch", values=values)


def _side_by_side(lines: list[Joint], report: Report) -> list[Joint]:
    """Closed lines of different phases between the same two buses made one, since a bus is fed by one branch."""
    found: dict[Any, Joint] = {}
    for k, line in enumerate(lines):
        pair = frozenset(line.ends)
        other = found.get(pair)
        if not line.closed or (other is not None and set(other.phases) & set(line.phases)):
            found[k] = line
        elif other is None:
            found[pair] = line
        else:
            report.add("nothing lost", "line", f"{other.name} and {line.name}", "of other phases: one row of both")
            found[pair] = _joined(other, line)
    return list(found.values())


def _joined(first: Joint, second: Joint) -> Joint:
    phases = "".join(sorted(first.phases + second.phases))
    name = f"{first.name}+{second.name}"
    if first.kind == second.kind == "switch" and first.values == second.values:
        return replace(first, name=name, phases=phases)
    columns = [_as_columns(one) for one in (first, second)]
    values = dict(columns[0])
    for key in ("r_ohm", "x_ohm", "b_us"):
        both = [np.array(one[key], float) for one in columns]
        full = np.where(np.isnan(both[0]), np.nan_to_num(both[1]), both[0])
        at = ["abc".index(phase) for phase in phases]
        values[key] = matrix_of(full[np.ix_(at, at)], phases)
    return replace(first, kind="phase_line", name=name, phases=phases, values=values)


def _as_columns(line: Joint) -> dict[str, Any]:
    """The columns of a line, also of a switch."""
    if line.kind == "phase_line":
        return line.values
    one, phases = np.eye(len(line.phases)), line.phases
    matrices = {key: matrix_of(line.values[key] * one, phases) for key in ("r_ohm", "x_ohm")}
    return {"length_m": math.nan, **matrices, "b_us": matrix_of(0.0 * one, phases)}
