"""Loads and transformer cores of an OpenDSS circuit as legs between two conductors, or from one to ground."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.opendss.dss_circuit import DssCircuit, Terminal
from dcgrid_env.apps.importers.opendss.dss_lines import rounded
from dcgrid_env.apps.importers.opendss.dss_shapes import LoadShapes
from dcgrid_env.apps.importers.opendss.dss_transformers import Unit
from dcgrid_env.apps.importers.opendss.joints import Letters, Supply
from dcgrid_env.grid.three_phase_checks import legs_of

_LAWS = {1: "PQ", 2: "Z", 3: "EXP", 4: "EXP", 5: "I", 8: "ZIP"}
_MOTOR = (0.0, 2.0)
Row = dict[str, Any]


def legs_between(end: Terminal, letters: Letters, size: int, delta: bool) -> list[str] | None:
    """The legs of an element by their conductors, as ``connections`` has them; None if it has none or one twice."""
    near = end.nodes[:size]
    if delta:
        far = [*end.nodes[1:size], *(end.nodes[size:] or end.nodes[:1])]
    else:
        far = [end.nodes[size] if len(end.nodes) > size else 0] * size
    legs = ["ca" if leg == "ac" else leg for leg in (letters.text(pair) for pair in zip(near, far, strict=True))]
    alike = any(one == other for one, other in zip(near, far, strict=True))
    return None if alike or len(set(legs)) < len(legs) else legs


def by_connection(of_leg: Mapping[str, float]) -> dict[str, tuple[float, ...]]:
    """The figure of each leg in the tables' order, for the connections that occur."""
    figures: dict[str, tuple[float, ...]] = {}
    for connection in ("wye", "delta"):
        known = legs_of(connection)
        if set(of_leg) & set(known):
            figures[connection] = tuple(of_leg.get(leg, 0.0) for leg in known)
    others = [leg for leg in of_leg if leg not in (*legs_of("wye"), *legs_of("delta"))]
    for first in range(0, len(others), 3):
        named = others[first : first + 3]
        figures[" ".join(named)] = (*(of_leg[leg] for leg in named), 0.0, 0.0)[:3]
    return figures


def read_loads(circuit: DssCircuit, report: Report, supply: Supply, letters: Letters, shapes: LoadShapes) -> list[Row]:
    """Rows of the loads that have supply and can be represented; their load shapes are noted in ``shapes``."""
    rows = []
    for name in circuit.names("load"):
        circuit.activate("load", name)
        end, size = circuit.terminals()[0], circuit.engine.CktElement.NumPhases()
        delta = circuit.text("conn").lower() in ("delta", "ll")
        legs = legs_between(end, letters, size, delta)
        if not set("".join(legs or "")) <= set(supply.phases.get(end.bus, "")) or end.bus not in supply.depth:
            report.add("lost", "isolated", f"load {name}", "without supply: it is left out")
            continue
        law = _law(circuit, report, name)
        if legs is None or any(map(any, circuit.open_conductors())):
            nodes = ".".join(map(str, end.nodes))
            report.add("refused", "load", name, f"its nodes {nodes} give no separate legs, or one is open")
        elif law is not None:
            of_load = _load_rows(circuit, name, end.bus, legs, size, delta, law)
            rows += of_load
            report.add("taken", "load", name, "in loads.csv")
            shapes.add(name, [row["name"] for row in of_load])
    return rows


def _load_rows(
    circuit: DssCircuit, name: str, bus: str, legs: list[str], size: int, delta: bool, law: Row
) -> list[Row]:
    engine = circuit.engine
    scaled = circuit.text("status").lower() == "variable"  # neither fixed nor exempt
    share = float(engine.Solution.LoadMult()) if scaled else 1.0
    p_kw, q_kvar = (rounded(share * circuit.figure(field) / size) for field in ("kw", "kvar"))
    kv = circuit.figure("kv") / (math.sqrt(3.0) if size > 1 and not delta else 1.0)
    vlow = circuit.figure("vlowpu")
    # OpenDSS asks for vlow first, so that below it nothing else counts; a step in place of the line between them.
    vmin = max(circuit.figure("vminpu"), vlow * (1.0 + 1e-9))
    common = {"bus": bus, "leg_kv": rounded(kv), "vmin_pu": vmin, "vmax_pu": circuit.figure("vmaxpu"), "vlow_pu": vlow}
    ps, qs = (by_connection(dict.fromkeys(legs, each)) for each in (p_kw, q_kvar))
    return [
        {"name": row_name(name, connection, len(ps)), "connection": connection, **common, **law,
         "p_kw": ps[connection], "q_kvar": qs[connection]}
        for connection in ps
    ]  # fmt: skip


def row_name(name: str, connection: str, n: int) -> str:
    """Name of the row of one connection of an element that has ``n``."""
    return name if n == 1 else f"{name}_{connection.replace(' ', '_')}"


def _law(circuit: DssCircuit, report: Report, name: str) -> Row | None:
    """Model and shares of a load; None, with its reason in the report, for one that the tables do not have."""
    model = int(circuit.figure("model"))
    if model not in _LAWS:
        report.add("refused", "load", name, f"model {model}; {', '.join(map(str, _LAWS))} can be represented")
        return None
    shares: tuple[float, ...] = ()
    if model == 8:
        *stated, cutoff = circuit.figures("zipv")
        shares = tuple(stated)
        if cutoff > 0:
            report.add("lost", "load", name, "the voltage below which it is off (ZIPV) is left out")
    exponents: tuple[float, ...] = _MOTOR if model == 3 else ()
    if model == 4:
        exponents = (circuit.figure("cvrwatts"), circuit.figure("cvrvars"))
        if circuit.text("cvrcurve"):
            report.add("lost", "load", name, "its exponents over time (CVRcurve) are left out")
    return {"model": _LAWS[model], "zip": shares, "exponents": exponents}


def core_rows(unit: Unit, report: Report) -> list[Row]:
    """No-load losses and magnetising current of a transformer, which are at its last winding, as a core."""
    if not unit.no_load_percent and not unit.magnetising_percent:
        return []
    last, size = unit.windings[1], len(unit.phases)
    delta = last.connection == "delta"
    p_kw, q_kvar = (p / 100.0 * unit.kva / size for p in (unit.no_load_percent, unit.magnetising_percent))
    legs = legs_of("delta") if delta else list(unit.phases)
    text = "its no-load losses and magnetising current are a constant impedance in the table of cores"
    report.add("nothing lost", "transformer", unit.name, text)
    [(connection, ps)] = by_connection(dict.fromkeys(legs, rounded(p_kw))).items()
    [(_, qs)] = by_connection(dict.fromkeys(legs, rounded(q_kvar))).items()
    kv = last.kv_ll * last.tap / (1.0 if delta else math.sqrt(3.0))
    return [
        {"name": unit.name, "bus": last.bus, "connection": connection, "leg_kv": rounded(kv), "p_kw": ps, "q_kvar": qs,
         "members": (f"transformer.{unit.name}",)}
    ]  # fmt: skip
