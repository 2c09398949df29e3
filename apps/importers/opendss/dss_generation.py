"""Generators, PV systems and storages as loads that inject their present power, as OpenDSS has solved it."""

from __future__ import annotations

import math

import numpy as np

from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.opendss.dss_circuit import DssCircuit
from dcgrid_env.apps.importers.opendss.dss_lines import rounded
from dcgrid_env.apps.importers.opendss.dss_loads import Row, by_connection, legs_between, row_name
from dcgrid_env.apps.importers.opendss.joints import Letters, Supply
from dcgrid_env.grid.three_phase_checks import FAR

KINDS = ("generator", "pvsystem", "storage")
_LAWS = {1: "PQ", 2: "Z", 4: "PQ"}
_LEAST_PU = 1e-3
"""Below ``vminpu`` the element is an impedance down to no voltage; the tables need a voltage where this ends."""


def read_generation(circuit: DssCircuit, report: Report, supply: Supply, letters: Letters) -> list[Row]:
    """Rows of the loads for what generates and has supply; the circuit must have been solved."""
    rows: list[Row] = []
    for kind in KINDS:
        for name in circuit.names(kind):
            circuit.activate(kind, name)
            end, size = circuit.terminals()[0], circuit.engine.CktElement.NumPhases()
            delta = circuit.text("conn").lower() in ("delta", "ll")
            legs = legs_between(end, letters, size, delta)
            if not set("".join(legs or "")) <= set(supply.phases.get(end.bus, "")) or end.bus not in supply.depth:
                report.add("lost", "isolated", f"{kind} {name}", "without supply: it is left out")
            elif legs is None or any(map(any, circuit.open_conductors())):
                report.add("refused", kind, name, f"its nodes {end.nodes} give no separate legs, or one is open")
            else:
                rows += _rows(circuit, report, kind, name, legs)
    return rows


def _rows(circuit: DssCircuit, report: Report, kind: str, name: str, legs: list[str]) -> list[Row]:
    model, size = int(circuit.figure("model")), len(legs)
    if model not in _LAWS:
        text = f"model {model}: it injects its present active and reactive power at any voltage within its limits"
        report.add("nothing lost", kind, name, text)
    delta = circuit.text("conn").lower() in ("delta", "ll")
    kv = rounded(circuit.figure("kv") / (math.sqrt(3.0) if size > 1 and not delta else 1.0))
    vmin, vmax = circuit.figure("vminpu"), circuit.figure("vmaxpu")
    power = np.asarray(circuit.engine.CktElement.TotalPowers(), np.float64)
    law, v = _LAWS.get(model, "PQ"), _across(circuit, size, delta)
    base_kv = circuit.base_kv_ln(circuit.terminals()[0].bus)
    if base_kv > 0.0 and not 1.0 / FAR < kv / base_kv < FAR:
        law, kv = "Z", base_kv
    circuit.activate(kind, name)
    v_pu = v / (1000.0 * kv)
    at_pu = np.clip(v_pu, vmin, vmax) if law == "PQ" else np.ones(size)
    equal = float(((v_pu / at_pu) ** 2).sum())  # beyond the limits it is an impedance
    p_kw, q_kvar = (rounded(figure / (equal or size)) for figure in power[:2])
    ps, qs = (by_connection(dict.fromkeys(legs, each)) for each in (p_kw, q_kvar))
    report.add("taken", kind, name, "in loads.csv, as a load that injects its present power")
    if any(circuit.text(field) for field in ("daily", "yearly", "duty")):
        report.add("nothing lost", kind, name, "its load shape is left out: it injects its present power")
    limits = {"vmin_pu": max(vmin, 2.0 * _LEAST_PU), "vmax_pu": vmax, "vlow_pu": _LEAST_PU}
    return [
        {"name": row_name(f"{kind}.{name}", connection, len(ps)),
         "bus": circuit.terminals()[0].bus, "connection": connection, "model": law, "leg_kv": kv,
         "p_kw": ps[connection], "q_kvar": qs[connection], "zip": (), "exponents": (), **limits}
        for connection in ps
    ]  # fmt: skip


def _across(circuit: DssCircuit, size: int, delta: bool) -> np.ndarray:
    """Voltages across the legs of the active element, V."""
    flat = np.asarray(circuit.engine.CktElement.Voltages(), np.float64)
    v = flat[::2] + 1j * flat[1::2]
    far = v[size] if len(v) > size else 0.0
    if delta and len(v) == size:
        far = np.roll(v, -1)
    return np.abs(v[:size] - far)
