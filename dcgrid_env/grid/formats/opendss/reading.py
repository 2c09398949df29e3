"""Read a three-phase grid from an OpenDSS master file, with a report on each element and OpenDSS's voltages."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dcgrid_env.grid.formats.import_report import Finding, Report
from dcgrid_env.grid.formats.opendss.dss_circuit import DssCircuit, loaded_circuit
from dcgrid_env.grid.formats.opendss.dss_lines import read_lines
from dcgrid_env.grid.formats.opendss.dss_loads import Row, core_rows, read_capacitors, read_loads
from dcgrid_env.grid.formats.opendss.dss_ratings import ScriptRatings
from dcgrid_env.grid.formats.opendss.dss_regulators import (
    Regulation,
    is_regulator,
    read_regulations,
    regulator_row,
)
from dcgrid_env.grid.formats.opendss.dss_source import ALLOWABLE, read_source, report_the_rest
from dcgrid_env.grid.formats.opendss.dss_transformers import Unit, merged, oriented, read_units, transformer_joint
from dcgrid_env.grid.formats.opendss.joints import Joint, Supply, supply_of
from dcgrid_env.grid.formats.three_phase_columns import says_nothing
from dcgrid_env.grid.network import (
    CapacitorTable,
    CoreTable,
    Network,
    NodeTable,
    PhaseLineTable,
    PhaseLoadTable,
    RegulatorTable,
    SwitchTable,
    TransformerTable,
)
from dcgrid_env.grid.topology import FeederError


@dataclass(frozen=True)
class Imported:
    """What was read from an OpenDSS circuit.

    Attributes
    ----------
    network
        Its tables, which ``ThreePhaseFeeder.from_network`` compiles.
    findings
        What became of each element.
    v_pu
        OpenDSS's voltage of each node of the tables to ground, complex p.u., by name such as ``"671.a"``, of the
        whole circuit as it stands after its script, controls off. Empty where OpenDSS found none.
    """

    network: Network
    findings: tuple[Finding, ...]
    v_pu: dict[str, complex]


def read_circuit(master: str | Path, *, allow: Collection[str] = (), trust: bool = False) -> Imported:
    """Read a circuit in this process, which OpenDSS may end: see ``read_opendss``, which has a child do it."""
    unknown = [kind for kind in allow if kind.lower() not in ALLOWABLE]
    if unknown:
        raise FeederError(f"allow: {unknown[0]!r} is no kind of loss; choose among {', '.join(ALLOWABLE)}")
    circuit = loaded_circuit(Path(master), trust)
    converged, report = circuit.solve(), Report()
    network = _network(circuit, report, ScriptRatings(circuit, Path(master), report), Path(master).name, allow)
    return Imported(network, report.findings, _voltages(circuit, network) if converged else {})


def _voltages(circuit: DssCircuit, network: Network) -> dict[str, complex]:
    volts, node = circuit.volts(), network.node
    rows = zip(node.bus, node.phase, node.base_kv_ln, strict=True)
    found = ((f"{bus}.{'abc'[phase - 1]}", volts.get(f"{bus}.{phase}"), kv) for bus, phase, kv in rows)
    return {name: v / (1000.0 * kv) for name, v, kv in found if v is not None}


def _network(
    circuit: DssCircuit, report: Report, ratings: ScriptRatings, script: str, allow: Collection[str]
) -> Network:
    source, source_bus = read_source(circuit, report)
    lines, units = read_lines(circuit, report, ratings), read_units(circuit, report, ratings)
    supply = supply_of(source_bus, [*lines, *_unit_joints(units)])
    for loop in supply.loops:
        kind = "transformer" if loop[0].kind == "unit" else "line"
        others = ", ".join(joint.name for joint in loop[1:])
        text = f"it closes a loop with {others or 'itself'}: open one of them"
        if len(loop) == 2 and not set(loop[0].phases) & set(loop[1].phases):
            text = f"it stands beside {others} for other phases: one branch must bring a bus all its phases"
        report.add("refused", kind, loop[0].name, text)
    lines = _with_supply(lines, supply, report)
    tables = _Tables(circuit, report, supply)
    for unit in units:
        tables.add(unit, tables.regulations.pop(unit.name.lower(), None))
    for regulation in tables.regulations.values():
        report.add("lost", "regcontrol", regulation.name, "its transformer is not in the tables")
    loads = read_loads(circuit, report, supply)
    capacitors = read_capacitors(circuit, report, supply)
    transformers = merged(tables.transformers, report)
    for joint in transformers:
        beside = [row["name"] for row in tables.regulators if (row["from_bus"], row["to_bus"]) == joint.ends]
        if beside:
            text = f"it stands beside the regulator {', '.join(beside)} without a RegControl of its own"
            report.add("refused", "transformer", joint.name, text)
    report_the_rest(circuit, report)
    report.refuse_unless(circuit.name, allow)
    return Network(
        name=circuit.name,
        source=source,
        node=_nodes(circuit, supply, tables.between),
        phase_line=_table(PhaseLineTable, _rows(lines, "phase_line")),
        switch=_table(SwitchTable, _rows(lines, "switch")),
        transformer=_table(TransformerTable, _rows(transformers, "transformer")),
        regulator=_table(RegulatorTable, tables.regulators),
        phase_load=_table(PhaseLoadTable, loads),
        capacitor=_table(CapacitorTable, capacitors),
        core=_table(CoreTable, tables.cores),
        frequency_hz=float(circuit.engine.Solution.Frequency()),
        source_of_facts=f"OpenDSS script {script}",
    )


def _unit_joints(units: Sequence[Unit]) -> Iterable[Joint]:
    """Yield one joint for all parallel transformers between two buses: see ``merged``."""
    found: dict[frozenset[str] | str, Joint] = {}
    for unit in units:
        first, second = unit.windings
        pair = frozenset((first.bus, second.bus))
        other = found.get(pair)
        if other is None:
            found[pair] = Joint("unit", unit.name, (first.bus, second.bus), unit.phases, True, {})
        elif set(other.phases) & set(unit.phases) and other.phases != unit.phases:
            found[unit.name] = Joint("unit", unit.name, (first.bus, second.bus), unit.phases, True, {})
        else:
            found[pair] = replace(other, phases="".join(sorted(set(other.phases + unit.phases))))
    return found.values()


def _with_supply(lines: Sequence[Joint], supply: Supply, report: Report) -> list[Joint]:
    kept = []
    for line in lines:
        if supply.fed(line):
            kept.append(line)
        else:
            fate = "lost" if line.closed else "nothing lost"
            report.add(fate, "isolated", f"line {line.name}", "without supply at an end: it is left out")
    return kept


class _Tables:
    """Transformers and regulators as they are sorted, with the buses that come between them."""

    def __init__(self, circuit: DssCircuit, report: Report, supply: Supply) -> None:
        self.report, self.supply = report, supply
        self.regulations = read_regulations(circuit, report)
        self.transformers: list[Joint] = []
        self.regulators: list[Row] = []
        self.cores: list[Row] = []
        self.between: dict[str, tuple[str, str]] = {}
        """Phases of each bus that was put in, and the bus whose base voltage and coordinates it has."""

    def add(self, unit: Unit, regulation: Regulation | None) -> None:
        """Take a transformer, with its control if it has one."""
        report, supply = self.report, self.supply
        if not all(winding.bus in supply.depth for winding in unit.windings):
            report.add("lost", "isolated", f"transformer {unit.name}", "without supply: it is left out")
            return
        self.cores += core_rows(unit, report)
        tapped = unit.windings[regulation.winding - 1] if regulation else None
        unit = oriented(unit, supply.depth)
        if regulation and tapped is not unit.windings[1]:
            report.add("lost", "regcontrol", regulation.name, "it taps the side that is fed from: the tap is fixed")
            regulation = None
        first, second = unit.windings
        joint = None
        if not regulation:
            joint = transformer_joint(unit, second.bus, second.tap)
        elif not is_regulator(unit):
            joint = transformer_joint(unit, self._between(unit), 1.0)
        if isinstance(joint, str):
            report.add("refused", "transformer", unit.name, joint)
            return
        if joint:
            self.transformers.append(joint)
            report.add("taken", "transformer", unit.name, "in transformers.csv")
        else:
            report.add("taken", "transformer", unit.name, "in regulators.csv, with its control")
        row = regulator_row(unit, regulation, joint.ends[1] if joint else first.bus, report) if regulation else None
        self.regulators += [row] if row else []

    def _between(self, unit: Unit) -> str:
        first, second = unit.windings
        bus = f"{first.bus}-{second.bus}"
        phases = self.between.get(bus, ("", ""))[0] + unit.phases
        self.between[bus] = ("".join(sorted(phases)), second.bus)
        return bus


def _nodes(circuit: DssCircuit, supply: Supply, between: dict[str, tuple[str, str]]) -> NodeTable:
    rows: list[tuple[Any, ...]] = []
    fed = {bus: (phases, bus) for bus, phases in supply.phases.items()}
    for bus, (phases, like) in (fed | between).items():
        base_kv, (x, y) = circuit.base_kv_ln(like), circuit.coordinates(like)
        if not base_kv > 0:
            raise FeederError(
                f"circuit {circuit.name!r}: bus {bus} has no base voltage; add Set VoltageBases=[..] and "
                "CalcVoltageBases to the script"
            )
        if not (math.isfinite(x) and math.isfinite(y)):
            x = y = math.nan
        rows += [(bus, "abc".index(phase) + 1, x, y, base_kv) for phase in phases]
    return NodeTable(*zip(*rows, strict=True))


def _rows(joints: Iterable[Joint], kind: str) -> list[Row]:
    return [
        {"name": joint.name, "from_bus": joint.ends[0], "to_bus": joint.ends[1], "phases": joint.phases, **joint.values}
        for joint in joints
        if joint.kind == kind
    ]


def _table(table: type[Any], rows: Sequence[Row]) -> Any:
    """A table out of its rows; each has every column. Ratings that say nothing are left out."""
    columns = {field.name: tuple(row[field.name] for row in rows) for field in dataclasses.fields(table)}
    return table(**{name: values for name, values in columns.items() if not says_nothing(name, columns)})
