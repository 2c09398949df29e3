"""The source of an OpenDSS circuit, an ideal one behind an impedance, and the elements that no table has."""

from __future__ import annotations

import math

import numpy as np

from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.opendss.dss_circuit import DssCircuit
from dcgrid_env.apps.importers.opendss.dss_generation import KINDS as GENERATION
from dcgrid_env.apps.importers.opendss.dss_lines import matrix_of
from dcgrid_env.apps.importers.opendss.dss_switching import SWITCHING, kept_state
from dcgrid_env.grid.network import SourceTable
from dcgrid_env.grid.topology import FeederError

_READ = (
    "vsource",
    "line",
    "reactor",
    "fault",
    "transformer",
    "regcontrol",
    "load",
    "capacitor",
    "capcontrol",
    *GENERATION,
)
_NO_LOSS = {
    "monitor": "it measures alone",
    "energymeter": "it measures alone",
    "sensor": "it measures alone",
}
LOSSES = {
    "isource": "what it injects is left out",
    "vccs": "what it injects is left out",
    "indmach012": "what it draws is left out",
    "invcontrol": "its inverters are not controlled by it",
    "expcontrol": "its inverters are not controlled by it",
    "storagecontroller": "its storage is not controlled by it",
    "gendispatcher": "its generators are not controlled by it",
    "espvlcontrol": "what it controls is left alone",
}
"""Classes of elements that can be left out, and what is lost with each."""
ALLOWABLE = (*LOSSES, "capcontrol", "regcontrol", "load", "isolated")
"""Kinds of loss that can be allowed."""


def read_source(circuit: DssCircuit, report: Report) -> tuple[SourceTable, str]:
    """The source's table and its bus.

    FeederError where it is not one source of three phases between phases and ground; it could not be left out.
    """
    names = circuit.names("vsource")
    if len(names) != 1:
        raise FeederError(f"circuit {circuit.name!r} has the sources {', '.join(names)}; one can be represented")
    circuit.activate("vsource", names[0])
    ends = circuit.terminals()
    if ends[0].nodes != (1, 2, 3) or any(ends[1].nodes):
        raise FeederError(
            f"source {names[0]} stands between {ends[0].nodes} of {ends[0].bus} and {ends[1].nodes} of {ends[1].bus}; "
            "it must be from the phases 1 2 3 to ground"
        )
    if circuit.text("sequence").lower() not in ("pos", "positive"):
        raise FeederError(f"source {names[0]}: sequence is {circuit.text('sequence')}; it must be positive")
    try:
        z = np.linalg.inv(circuit.admittance()[:3, :3])
    except np.linalg.LinAlgError:
        raise FeederError(f"source {names[0]}: its impedance is too large; give R1, X1, R0 and X0") from None
    base_kv, v_pu, angle_deg = (circuit.figure(field) for field in ("basekv", "pu", "angle"))
    report.add("taken", "vsource", names[0], "in feeder.toml")
    of_bus = circuit.base_kv_ln(ends[0].bus) * math.sqrt(3.0)
    if of_bus and not math.isclose(of_bus, base_kv, rel_tol=1e-9):
        base_kv, v_pu = of_bus, v_pu * base_kv / of_bus
    matrices = ((matrix_of(part, "abc"),) for part in (z.real, z.imag))
    return SourceTable((ends[0].bus,), (base_kv,), (v_pu,), (angle_deg,), *matrices), ends[0].bus


def report_the_rest(circuit: DssCircuit, report: Report) -> None:
    """Note the elements that are of no table here, and those that are disabled."""
    for kind in circuit.kinds():
        for name in circuit.disabled(kind) if kind not in ("regcontrol", "capcontrol") else ():
            report.add("nothing lost", kind, name, "disabled: it is not in the circuit")
        for name in circuit.names(kind) if kind not in _READ else ():
            if kind in SWITCHING:
                report.add("nothing lost", kind, name, kept_state(circuit, kind, name))
            elif kind in _NO_LOSS:
                report.add("nothing lost", kind, name, _NO_LOSS[kind])
            elif kind not in LOSSES or (kind == "vccs" and _in_series(circuit, name)):
                report.add("refused", kind, name, "an element of this kind cannot be represented")
            else:
                report.add("lost", kind, name, LOSSES[kind])


def _in_series(circuit: DssCircuit, name: str) -> bool:
    circuit.activate("vccs", name)
    return len({end.bus for end in circuit.terminals()}) > 1
