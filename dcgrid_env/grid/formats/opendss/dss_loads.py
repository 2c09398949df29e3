"""Loads and capacitors of an OpenDSS circuit as legs between two phases, or between a phase and ground."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from dcgrid_env.grid.formats.import_report import Report
from dcgrid_env.grid.formats.opendss.dss_circuit import DssCircuit, Terminal
from dcgrid_env.grid.formats.opendss.dss_lines import rounded
from dcgrid_env.grid.formats.opendss.dss_transformers import Unit
from dcgrid_env.grid.formats.opendss.joints import Supply

_LAWS = {1: "PQ", 2: "Z", 3: "ZIP", 4: "CVR", 5: "I", 8: "ZIP"}
_MOTOR = (0.0, 0.0, 1.0, 1.0, 0.0, 0.0)
_LEGS = {(1, 0): 0, (2, 0): 1, (3, 0): 2, (1, 2): 3, (2, 3): 4, (1, 3): 5}
_JUMPS = "; beyond vminpu and vmaxpu OpenDSS has constant power's limits for models 3 and 4, the tables their law's"
Row = dict[str, Any]


def legs_between(end: Terminal, size: int, delta: bool, neutral: Sequence[int] | None = None) -> list[int] | None:
    """Which legs an element has: 0 to 2 from a, b, c to ground, 3 to 5 from a to b, b to c, c to a; None if others."""
    near = end.nodes[:size]
    if delta:
        far = [*end.nodes[1:size], *(end.nodes[size:] or end.nodes[:1])]
    else:
        far = list(neutral) if neutral is not None else [end.nodes[size] if len(end.nodes) > size else 0] * size
    pairs = [tuple(sorted(pair, key=lambda node: node or 9)) for pair in zip(near, far, strict=True)]
    legs = [_LEGS.get((pair[0], pair[1])) for pair in pairs]
    return None if None in legs or len(set(legs)) < len(legs) else [leg for leg in legs if leg is not None]


def by_connection(legs: Sequence[int], each: float) -> dict[str, tuple[float, float, float]]:
    """The figure of each leg in the tables' order, for the connections that occur."""
    found = {}
    for connection, first in (("wye", 0), ("delta", 3)):
        if any(first <= leg < first + 3 for leg in legs):
            found[connection] = tuple(each if first + k in legs else 0.0 for k in range(3))
    return found


def read_loads(circuit: DssCircuit, report: Report, supply: Supply) -> list[Row]:
    """Rows of the loads that have supply and can be represented."""
    rows = []
    for name in circuit.names("load"):
        circuit.activate("load", name)
        end, size = circuit.terminals()[0], circuit.engine.CktElement.NumPhases()
        if end.bus not in supply.depth:
            report.add("lost", "isolated", f"load {name}", "without supply: it is left out")
            continue
        delta = circuit.text("conn").lower() in ("delta", "ll")
        legs = legs_between(end, size, delta)
        law = _law(circuit, report, name)
        if legs is None or any(map(any, circuit.open_conductors())):
            nodes = ".".join(map(str, end.nodes))
            report.add("refused", "load", name, f"its nodes {nodes} are no legs of phases and ground, or one is open")
        elif law is not None:
            rows += _load_rows(circuit, name, end.bus, legs, size, delta, law)
            report.add("taken", "load", name, f"in loads.csv{_JUMPS if circuit.figure('model') in (3, 4) else ''}")
            if any(circuit.text(field) for field in ("daily", "yearly", "duty")):
                report.add("nothing lost", "load", name, "its course over time is left out: the power flow is of now")
    return rows


def _load_rows(
    circuit: DssCircuit, name: str, bus: str, legs: list[int], size: int, delta: bool, law: Row
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
    ps, qs = by_connection(legs, p_kw), by_connection(legs, q_kvar)
    return [
        {"name": name if len(ps) == 1 else f"{name}_{connection}", "connection": connection, **common, **law,
         "p_kw": ps[connection], "q_kvar": qs[connection]}
        for connection in ps
    ]  # fmt: skip


def _law(circuit: DssCircuit, report: Report, name: str) -> Row | None:
    """Model and shares of a load; None, with its reason in the report, for one that the tables do not have."""
    model = int(circuit.figure("model"))
    if model not in _LAWS:
        report.add("refused", "load", name, f"model {model}; {', '.join(map(str, _LAWS))} can be represented")
        return None
    shares: tuple[float, ...] = _MOTOR if model == 3 else ()
    if model == 8:
        *given, cutoff = circuit.figures("zipv")
        shares = tuple(given)
        if cutoff > 0:
            report.add("lost", "load", name, "the voltage below which it is off (ZIPV) is left out")
    if model == 4:
        watts, vars_ = circuit.figure("cvrwatts"), circuit.figure("cvrvars")
        if circuit.text("cvrcurve"):
            report.add("lost", "load", name, "its exponents over time (CVRcurve) are left out")
        if (watts, vars_) != (1.0, 2.0):
            shares = (*_shares_of(watts), *_shares_of(vars_))
            if not {watts, vars_} <= {0.0, 1.0, 2.0}:
                report.add("lost", "load", name, "its exponents become ZIP shares of the same slope at rated voltage")
            return {"model": "ZIP", "zip": shares}
    return {"model": _LAWS[model], "zip": shares}


def _shares_of(exponent: float) -> tuple[float, float, float]:
    """Shares of impedance, current and power that have a power's value and slope at rated voltage."""
    return (0.0, exponent, 1.0 - exponent) if exponent <= 1.0 else (exponent - 1.0, 2.0 - exponent, 0.0)


def core_rows(unit: Unit, report: Report) -> list[Row]:
    """No-load losses and magnetising current of a transformer, which are at its last winding, as a core."""
    if not unit.no_load_percent and not unit.magnetising_percent:
        return []
    last, size = unit.windings[1], len(unit.phases)
    delta = last.connection == "delta"
    p_kw, q_kvar = (p / 100.0 * unit.kva / size for p in (unit.no_load_percent, unit.magnetising_percent))
    legs = [3, 4, 5] if delta else ["abc".index(phase) for phase in unit.phases]
    text = "its no-load losses and magnetising current are a constant impedance in the table of cores"
    report.add("nothing lost", "transformer", unit.name, text)
    [(connection, ps)] = by_connection(legs, rounded(p_kw)).items()
    [(_, qs)] = by_connection(legs, rounded(q_kvar)).items()
    kv = last.kv_ll * last.tap / (1.0 if delta else math.sqrt(3.0))
    return [
        {"name": unit.name, "bus": last.bus, "connection": connection, "leg_kv": rounded(kv), "p_kw": ps, "q_kvar": qs}
    ]  # fmt: skip


def read_capacitors(circuit: DssCircuit, report: Report, supply: Supply) -> list[Row]:
    """Rows of the capacitors that have supply, one for each step of a bank."""
    rows = []
    for name in circuit.names("capacitor"):
        circuit.activate("capacitor", name)
        ends, size = circuit.terminals(), circuit.engine.CktElement.NumPhases()
        if ends[0].bus not in supply.depth:
            report.add("lost", "isolated", f"capacitor {name}", "without supply: it is left out")
            continue
        delta = circuit.text("conn").lower() in ("delta", "ll")
        legs = None
        if len(ends) == 1 or (ends[1].bus == ends[0].bus and not any(map(any, circuit.open_conductors()))):
            legs = legs_between(ends[0], size, delta, None if delta else ends[1].nodes[:size])
        if legs is None or any(circuit.figures("r") + circuit.figures("xl")):
            wrong = "it is in series, not at ground, open at a terminal, or has a resistance or reactance of its own"
            report.add("refused", "capacitor", name, wrong)
            continue
        kv = circuit.figure("kv") / (math.sqrt(3.0) if size > 1 and not delta else 1.0)
        rows += _capacitor_rows(circuit, name, ends[0].bus, legs, kv)
        report.add("taken", "capacitor", name, "in capacitors.csv")
    return rows


def _capacitor_rows(circuit: DssCircuit, name: str, bus: str, legs: list[int], kv: float) -> list[Row]:
    steps, states = circuit.figures("kvar"), circuit.figures("states")
    rows = []
    for k, kvar in enumerate(steps):
        of_step = name if len(steps) == 1 else f"{name}_{k + 1}"
        for connection, each in by_connection(legs, rounded(kvar / len(legs))).items():
            on = k < len(states) and bool(states[k])
            rows.append({"name": of_step, "bus": bus, "connection": connection, "leg_kv": rounded(kv), "kvar": each,
                         "state": "on" if on else "off"})  # fmt: skip
    return rows
