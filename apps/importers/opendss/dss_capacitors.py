"""Capacitors of an OpenDSS circuit as legs, with the susceptances of OpenDSS's admittance matrices.

A bank may be rated by ``kvar``, ``cuf`` or ``cmatrix``, at another frequency, with a reactance (``xl``, ``harm``), and
in steps, of which each has the first ``kvar`` in OpenDSS. The matrix of each step contains all of this.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np

from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.opendss.dss_admittances import admittance_at_nodes, admittance_joint
from dcgrid_env.apps.importers.opendss.dss_circuit import DssCircuit
from dcgrid_env.apps.importers.opendss.dss_lines import report_admittance, rounded
from dcgrid_env.apps.importers.opendss.dss_loads import Row, by_connection, row_name
from dcgrid_env.apps.importers.opendss.joints import Joint, Letters, Node, Supply
from dcgrid_env.grid.three_phase_checks import FAR

_SAME = 1e-9
"""Share of a bank's largest admittance below which another one is rounding."""
_RATING = 1e-6
"""Relative difference of a bank's kvar from its property beyond which it is reported."""
Legs = Mapping[str, float]
"""Susceptance of each leg by its conductors, S."""


def capacitor_steps(circuit: DssCircuit, letters: Letters, generic: Iterable[str]) -> dict[str, list[Legs] | None]:
    """The legs of each step of each bank; None for a bank that is to be a row of the admittances, or is in ``generic``.

    Each step is read alone. Afterwards the circuit is as before, with its voltages.
    """
    names = circuit.names("capacitor")
    states = {name: _states(circuit, name) for name in names}
    opened = [name for name in names if _is_open(circuit, name)]
    steps_by_bank: dict[str, list[Legs] | None] = {
        name: None if f"capacitor.{name}" in generic else [] for name in names
    }
    for name in opened:
        circuit.activate("capacitor", name)
        circuit.engine.CktElement.Close(1, 0)
    for k in range(max(map(len, states.values()), default=0)):
        for name, before in states.items():
            _set_states(circuit, name, [int(step == k) for step in range(len(before))])
        circuit.build_admittances()
        for name, before in states.items():
            steps = steps_by_bank[name]
            if steps is not None and k < len(before):
                legs = _legs(circuit, letters, name)
                steps_by_bank[name] = None if legs is None else [*steps, legs]
    for name, before in states.items():
        _set_states(circuit, name, before)
    for name in opened:
        circuit.activate("capacitor", name)
        circuit.engine.CktElement.Open(1, 0)
    if names:
        circuit.build_admittances()
    return steps_by_bank


def _states(circuit: DssCircuit, name: str) -> list[int]:
    circuit.engine.Capacitors.Name(name)
    return [int(state) for state in circuit.engine.Capacitors.States()]


def _set_states(circuit: DssCircuit, name: str, states: list[int]) -> None:
    circuit.engine.Capacitors.Name(name)
    circuit.engine.Capacitors.States(states)


def _is_open(circuit: DssCircuit, name: str) -> bool:
    """Whether a bank is open, as CapControls leave one without a step that is on."""
    circuit.activate("capacitor", name)
    return all(circuit.open_conductors()[0])


def _legs(circuit: DssCircuit, letters: Letters, name: str) -> Legs | None:
    """The legs of the bank with the steps that are on; None unless they are susceptances at one bus."""
    circuit.activate("capacitor", name)
    admittance = admittance_at_nodes(circuit, letters)
    if admittance is None:
        return None
    nodes, y = admittance
    least = _SAME * np.abs(y).max(initial=0.0)
    if len({bus for bus, _ in nodes}) != 1 or max(np.abs(y.real).max(), np.abs(y - y.T).max()) > least:
        return None
    b = y.imag
    susceptances = {letter: float(b[k].sum()) for k, (_, letter) in enumerate(nodes)}
    for i, j in zip(*np.triu_indices(len(nodes), 1), strict=True):
        leg = "".join(sorted(nodes[i][1] + nodes[j][1]))
        susceptances["ca" if leg == "ac" else leg] = -float(b[i, j])
    susceptances = {leg: value for leg, value in susceptances.items() if abs(value) > least}
    return susceptances if susceptances and min(susceptances.values()) > 0.0 else None


def step_nodes(bus: str, steps: Iterable[Legs]) -> list[Node]:
    """Nodes of a bank at a bus."""
    return [(bus, letter) for letter in sorted({letter for legs in steps for leg in legs for letter in leg})]


def capacitor_admittances(
    circuit: DssCircuit, report: Report, letters: Letters, steps: Mapping[str, list[Legs] | None]
) -> list[Joint]:
    """Rows of the admittances for the banks that have no legs."""
    joints = []
    for name, of_steps in steps.items():
        if of_steps is None:
            joint = admittance_joint(circuit, letters, "capacitor", name)
            reason = "in series, at no separate legs, or with a resistance; it stays in its present state"
            report_admittance(report, "capacitor", name, joint, reason)
            joints += [joint] if isinstance(joint, Joint) else []
    return joints


def read_capacitors(
    circuit: DssCircuit,
    report: Report,
    supply: Supply,
    steps: Mapping[str, list[Legs] | None],
    fixed: Collection[str],
) -> tuple[list[Row], dict[str, list[list[str]]]]:
    """Rows of the capacitors that have supply, one for each step of a bank, and their names by bank and step.

    ``fixed`` are the names of those that stay in their state, in lower case.
    """
    rows: list[Row] = []
    names: dict[str, list[list[str]]] = {}
    for name, of_steps in steps.items():
        if of_steps is None:
            continue  # among the admittances
        circuit.activate("capacitor", name)
        bus = circuit.terminals()[0].bus
        if not supply.has(step_nodes(bus, of_steps)):
            report.add("lost", "isolated", f"capacitor {name}", "without supply: it is left out")
            continue
        step_rows = _rows(circuit, name, bus, of_steps, int(name.lower() in fixed))
        names[name.lower()] = [[row["name"] for row in of_step] for of_step in step_rows]
        rows += [row for of_step in step_rows for row in of_step]
        report.add("taken", "capacitor", name, "in capacitors.csv")
        _report_rating(circuit, report, name, step_rows)
    return rows, names


def _rows(circuit: DssCircuit, name: str, bus: str, of_steps: list[Legs], is_fixed: int) -> list[list[Row]]:
    size, delta = circuit.engine.CktElement.NumPhases(), circuit.text("conn").lower() in ("delta", "ll")
    kv = circuit.figure("kv") / (math.sqrt(3.0) if size > 1 and not delta else 1.0)
    base_kv = circuit.base_kv_ln(bus)
    if base_kv > 0.0 and not 1.0 / FAR < kv / base_kv < FAR:
        kv = base_kv  # as of one rated by its capacitance
    states = [0] * len(of_steps) if _is_open(circuit, name) else _states(circuit, name)
    rows: list[list[Row]] = []
    for k, legs in enumerate(of_steps):
        of_step = name if len(of_steps) == 1 else f"{name}_{k + 1}"
        row: dict[str, Any] = {
            "bus": bus,
            "leg_kv": rounded(kv),
            "state": "on" if states[k] == 1 else "off",
            "is_fixed": is_fixed,
            "members": (f"capacitor.{name}",),
        }
        kvar = by_connection({leg: rounded(1000.0 * kv**2 * b) for leg, b in legs.items()})
        rows.append([row | {"name": row_name(of_step, connection, len(kvar)), "connection": connection, "kvar": of_legs}
                     for connection, of_legs in kvar.items()])  # fmt: skip
    return rows


def _report_rating(circuit: DssCircuit, report: Report, name: str, rows: list[list[Row]]) -> None:
    circuit.activate("capacitor", name)
    named = sum(circuit.figures("kvar"))
    kvar = sum(sum(row["kvar"]) for of_step in rows for row in of_step)
    if not math.isclose(kvar, named, rel_tol=_RATING):
        text = f"it has {kvar:.6g} kvar in OpenDSS's power flow, and so in the table; its property kvar is {named:.6g}"
        report.add("nothing lost", "capacitor", name, text)
