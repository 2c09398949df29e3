"""Lines, switches and reactors of an OpenDSS circuit: whole matrices, from OpenDSS's own admittances."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.opendss.dss_admittances import admittance_joint
from dcgrid_env.apps.importers.opendss.dss_circuit import DssCircuit
from dcgrid_env.apps.importers.opendss.dss_ratings import ScriptRatings
from dcgrid_env.apps.importers.opendss.joints import Joint, Letters
from dcgrid_env.grid.three_phase_tables import Matrix

_ROUNDING = 1e-12  # relative, of what an inverse leaves in place of 0
_CANCELLED = 2e-15
"""Relative, of what the difference of two entries leaves in place of 0; short cables have little more charging."""
_SWITCH_B_US = 1e-3
"""Charging that a switch is not thought to have: OpenDSS's own default is 2e-4 microsiemens."""
_NO_PHASE = math.nan
UNLIKE = "a row of another table would not have its admittances"
"""Why an element whose row differs from OpenDSS's matrix is a row of the admittances."""
_METRES = {"mi": 1609.344, "kft": 304.8, "km": 1000.0, "m": 1.0, "ft": 0.3048, "in": 0.0254, "cm": 0.01, "mm": 0.001}


def read_lines(
    circuit: DssCircuit, report: Report, ratings: ScriptRatings, letters: Letters, generic: Collection[str]
) -> list[Joint]:
    """Read the lines, switches, reactors and fault resistances, and report them.

    Those in ``generic``, as class.name, become rows of the admittances.
    """
    named = [(kind, name) for kind in ("line", "reactor", "fault") for name in circuit.names(kind)]
    joints = []
    for kind, name in named:
        rating_a = ratings.of_conductor(kind, name) if kind != "fault" else math.nan
        branch = kind == "line" or (kind == "reactor" and _in_series(circuit, name))
        line: Joint | str | None = "" if not branch else UNLIKE
        if branch and f"{kind}.{name}" not in generic:
            line = _line(circuit, report, kind, name, rating_a)
        if isinstance(line, str):
            reason, line = line, admittance_joint(circuit, letters, kind, name, rating_a)
            report_admittance(report, kind, name, line, reason)
        joints.append(line)
        if isinstance(line, Joint) and line.kind == "switch" and not line.closed:
            joints.append(_open_line_charging(circuit, report, letters, kind, name))
    return _side_by_side([line for line in joints if isinstance(line, Joint)], report)


def report_admittance(report: Report, kind: str, name: str, joint: Joint | str | None, reason: str) -> None:
    """Report an element that may be a row of the admittances, with the reason."""
    if isinstance(joint, str):
        report.add("refused", kind, name, joint)
    elif joint:
        report.add("taken", kind, name, f"in admittances.csv{f': {reason}' if reason else ''}")
    else:
        report.add("nothing lost", kind, name, "it connects nothing")


def _open_line_charging(circuit: DssCircuit, report: Report, letters: Letters, kind: str, name: str) -> Joint | None:
    """The admittance that an open line keeps at an end that is not open; None if it is that of a switch."""
    joint = admittance_joint(circuit, letters, kind, name)
    if not isinstance(joint, Joint) or max(map(abs, joint.values["b_s"])) < 1e-6 * _SWITCH_B_US:
        return None
    report.add("nothing lost", kind, name, "its charging at the end that is not open is in admittances.csv")
    return replace(joint, closed=False)


def _in_series(circuit: DssCircuit, name: str) -> bool:
    circuit.activate("reactor", name)
    return len({end.bus for end in circuit.terminals()}) > 1


def _line(circuit: DssCircuit, report: Report, kind: str, name: str, rating_a: float) -> Joint | str:
    """The row of a line or switch, or why it is to be a row of the admittances."""
    circuit.activate(kind, name)
    first, second = circuit.terminals()
    wrong = _wrong_ends(first.nodes, second.nodes)
    opened = [all(phases) for phases in circuit.open_conductors()]
    if any(any(phases) for phases in circuit.open_conductors()) and not any(opened):
        wrong = "some of its phases are open"
    if wrong:
        return wrong
    with circuit.closed():
        y = circuit.admittance()
    n = len(first.nodes)
    shunt = y[:n, :n] + y[:n, n:]
    series = np.abs(y[:n, n:]).max()
    if np.abs(shunt.real).max() > _ROUNDING * series + 1e-9 * np.abs(shunt).max():
        return "it has a shunt conductance"
    try:
        z = np.linalg.inv(-y[:n, n:])
    except np.linalg.LinAlgError:
        return "its admittance matrix has no inverse"
    b_us = 2e6 * np.where(np.abs(shunt.imag) > _CANCELLED * series, shunt.imag, 0.0)  # half of it stands at this end
    phases = "".join("abc"[node - 1] for node in sorted(first.nodes))
    turned = np.argsort(first.nodes)
    z, b_us = z[np.ix_(turned, turned)], b_us[np.ix_(turned, turned)]
    ends = (first.bus, second.bus)
    length_m = _length_m(circuit) if kind == "line" else math.nan
    is_switch = kind == "line" and circuit.yes("switch")
    values = _columns(length_m, z, b_us, phases) | {"rating_a": rating_a}
    joint = Joint("phase_line", name, ends, phases, not any(opened), values, members=(f"{kind}.{name}",))
    return _as_switch(report, kind, joint, is_switch, z, b_us)


def _wrong_ends(first: tuple[int, ...], second: tuple[int, ...]) -> str:
    if not (set(first) | set(second)) <= {1, 2, 3}:
        return "it has a conductor other than phases"
    if len(set(first)) < len(first):
        return "two of its conductors stand at one node"
    return "its phases change along it" if first != second else ""


def _length_m(circuit: DssCircuit) -> float:
    return rounded(circuit.figure("length") * _METRES.get(circuit.text("units").lower(), math.nan))


def _columns(length_m: float, z: NDArray[np.complexfloating], b_us: NDArray[Any], phases: str) -> dict[str, Any]:
    matrices = {"r_ohm": z.real, "x_ohm": z.imag, "b_us": b_us}
    return {"length_m": length_m, **{key: matrix_of(value, phases) for key, value in matrices.items()}}


def matrix_of(values: NDArray[Any], phases: str) -> Matrix:
    """Figures over the phases that exist as three rows of three, symmetric and rounded to 12 digits."""
    least = _ROUNDING * float(np.abs(values).max())
    full = np.full((3, 3), _NO_PHASE)
    positions = ["abc".index(phase) for phase in phases]
    full[np.ix_(positions, positions)] = np.where(np.abs(values) > least, 0.5 * (values + values.T), 0.0)
    return tuple(tuple(rounded(value) for value in row) for row in full.tolist())


def rounded(value: float) -> float:
    """A figure to 12 significant digits: the rounding of an inverse is not kept."""
    return float(f"{value:.12g}")


def _as_switch(report: Report, kind: str, line: Joint, is_switch: bool, z: np.ndarray, b_us: np.ndarray) -> Joint:
    """Make a switch of a line that is one, or that is open, and report what is lost."""
    one = z[0, 0]
    alike = np.allclose(z, one * np.eye(len(z)), rtol=0.0, atol=1e-9 * abs(one))
    bare = alike and float(np.abs(b_us).max()) < _SWITCH_B_US
    if line.closed and not (bare and is_switch):
        report.add("taken", kind, line.name, "in lines.csv")
        return line
    mean = complex(np.diag(z).mean())
    values = {"state": "closed" if line.closed else "open", "r_ohm": rounded(mean.real), "x_ohm": rounded(mean.imag)}
    values = {key: 0.0 if isinstance(v, float) and abs(v) < _ROUNDING * abs(mean) else v for key, v in values.items()}
    values["rating_a"] = line.values["rating_a"]
    report.add("taken", kind, line.name, "in switches.csv" if bare else "open: in switches.csv, mean impedance alone")
    return replace(line, kind="switch", values=values)


def _side_by_side(lines: list[Joint], report: Report) -> list[Joint]:
    """Closed lines between the same two buses made one, since a bus is fed by one branch."""
    joints: dict[Any, Joint] = {}
    for k, line in enumerate(lines):
        pair = frozenset(line.ends) if line.closed and line.kind != "admittance" else k
        other = joints.get(pair)
        if other:
            text = "beside each other between two buses: one row that is both, rated as balanced currents divide"
            report.add("nothing lost", "line", f"{other.name} and {line.name}", text)
        joints[pair] = _joined(other, line) if other else line
    return list(joints.values())


def _joined(first: Joint, second: Joint) -> Joint:
    """Two closed lines as one whose admittance is the sum of theirs."""
    phases = "".join(sorted(set(first.phases + second.phases)))
    name, members = f"{first.name}+{second.name}", (*first.members, *second.members)
    of_other_phases = len(phases) == len(first.phases + second.phases)
    if first.kind == second.kind == "switch" and first.values == second.values and of_other_phases:
        return replace(first, name=name, phases=phases, members=members)
    positions = ["abc".index(phase) for phase in phases]
    y, b_us = np.zeros((2, 3, 3), np.complex128), np.zeros((3, 3))
    for k, line in enumerate((first, second)):
        line_positions = ["abc".index(phase) for phase in line.phases]
        z, line_b_us = _matrices(line)
        y[k][np.ix_(line_positions, line_positions)] = np.linalg.inv(z)
        b_us[np.ix_(line_positions, line_positions)] += line_b_us
    z = np.linalg.inv(y.sum(axis=0)[np.ix_(positions, positions)])
    values = _columns(first.values.get("length_m", math.nan), z, b_us[np.ix_(positions, positions)], phases)
    balanced = np.exp(-2j / 3 * np.pi * np.array(positions))
    shares = np.abs(y[:, :, positions] @ z @ balanced)  # by line and phase
    ratings = [float(line.values["rating_a"]) for line in (first, second)]
    most = [rating / shares[k].max() for k, rating in enumerate(ratings)]
    values["rating_a"] = rounded(min(most)) if not any(map(math.isnan, most)) else math.nan
    return replace(first, kind="phase_line", name=name, phases=phases, values=values, members=members)


def _matrices(line: Joint) -> tuple[NDArray[Any], NDArray[Any]]:
    """Impedance and charging over the phases of a line or switch."""
    size = len(line.phases)
    if line.kind == "switch":
        return complex(line.values["r_ohm"], line.values["x_ohm"]) * np.eye(size), np.zeros((size, size))
    positions = ["abc".index(phase) for phase in line.phases]
    r, x, b_us = (np.array(line.values[key], float)[np.ix_(positions, positions)] for key in ("r_ohm", "x_ohm", "b_us"))
    return r + 1j * x, b_us
