"""Read a three-phase grid from an OpenDSS master file, with a report on each element and OpenDSS's voltages."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dcgrid_env.apps.importers.import_report import Finding, Report, shown_names
from dcgrid_env.apps.importers.opendss.dss_admittances import admittance_joint, part_with_supply
from dcgrid_env.apps.importers.opendss.dss_bases import check_frequency, derive_bases
from dcgrid_env.apps.importers.opendss.dss_capacitor_controls import fixed_capacitors, read_capacitor_controls
from dcgrid_env.apps.importers.opendss.dss_capacitors import (
    Legs,
    capacitor_admittances,
    capacitor_steps,
    read_capacitors,
)
from dcgrid_env.apps.importers.opendss.dss_check import SOLVABLE_PU, impedances_to_raise, unlike_elements
from dcgrid_env.apps.importers.opendss.dss_circuit import DssCircuit, loaded_circuit
from dcgrid_env.apps.importers.opendss.dss_further_ratings import with_further_ratings
from dcgrid_env.apps.importers.opendss.dss_generation import KINDS as GENERATION
from dcgrid_env.apps.importers.opendss.dss_generation import read_generation
from dcgrid_env.apps.importers.opendss.dss_lines import read_lines, report_admittance
from dcgrid_env.apps.importers.opendss.dss_loads import Row, core_rows, legs_between, read_loads
from dcgrid_env.apps.importers.opendss.dss_losses import LossEffect, Solved, loss_effects, solved
from dcgrid_env.apps.importers.opendss.dss_ratings import ScriptRatings
from dcgrid_env.apps.importers.opendss.dss_regulators import (
    Regulation,
    has_row,
    is_regulator,
    read_regulations,
    regulated_admittance,
    regulator_row,
)
from dcgrid_env.apps.importers.opendss.dss_shapes import ImportedProfiles, LoadShapes
from dcgrid_env.apps.importers.opendss.dss_source import ALLOWABLE, read_source, report_the_rest
from dcgrid_env.apps.importers.opendss.dss_switching import switch_as_asked
from dcgrid_env.apps.importers.opendss.dss_transformers import (
    Unit,
    fed_side_rating,
    merged,
    oriented,
    read_units,
    transformer_joint,
)
from dcgrid_env.apps.importers.opendss.joints import Joint, Letters, Node, Supply, supply_of
from dcgrid_env.core.files import sha256_of
from dcgrid_env.grid.formats.three_phase_columns import says_nothing
from dcgrid_env.grid.network import (
    AdmittanceTable,
    CapacitorControlTable,
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
from dcgrid_env.grid.three_phase_tables import LETTERS
from dcgrid_env.grid.topology import FeederError

_UNSETTLED = "its controls act until OpenDSS stops them: taps and switches are as the last iteration leaves them"


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
    v_pu_without
        OpenDSS's voltages with the lost elements disabled, in the same form.
    effects
        What the lost elements change in OpenDSS's power flow, by kind and, for several kinds, in all.
    files
        Name and SHA-256 of each file that was read, the master file first.
    engine
        Version of OpenDSS.
    profiles
        Profiles of the loads that follow load shapes, by mode.
    """

    network: Network
    findings: tuple[Finding, ...]
    v_pu: dict[str, complex]
    v_pu_without: dict[str, complex]
    effects: tuple[LossEffect, ...]
    files: tuple[tuple[str, str], ...]
    engine: str
    profiles: tuple[ImportedProfiles, ...] = ()


def read_circuit(
    master: str | Path, *, allow: Collection[str] = (), trust: bool = False, root: str | Path | None = None
) -> Imported:
    """Read a circuit in this process, which OpenDSS may end: see ``read_opendss``, which has a child do it."""
    unknown = [kind for kind in allow if kind.lower() not in ALLOWABLE]
    if unknown:
        raise FeederError(f"allow: {unknown[0]!r} is no kind of loss; choose among {', '.join(ALLOWABLE)}")
    folder = None if root is None else Path(root)
    circuit = loaded_circuit(Path(master), trust, folder)
    switch_as_asked(circuit)
    check_frequency(circuit)
    derived, before = derive_bases(circuit), solved(circuit)
    reading = _Reading(circuit, Path(master), folder, allow, derived)
    network, unlike = reading.network()
    if unlike:  # once more, with these by their admittance matrices
        reading = _Reading(circuit, Path(master), folder, allow, derived, unlike)
        network, unlike = reading.network()
    if unlike:
        raise FeederError(
            f"circuit {circuit.name!r}: {shown_names(unlike)}: the tables give other admittances than OpenDSS has; "
            "leave the element out, or give its values in another form"
        )
    report, profiles = reading.report, reading.profiles
    raised = impedances_to_raise(network, reading.members) if before else {}
    if raised:
        circuit.raise_impedances(raised)
        before = solved(circuit)
        text = (
            f"its impedance is near 0, where OpenDSS's voltages are inexact: compared with {SOLVABLE_PU:g} p.u. instead"
        )
        for kind, _, name in (full.partition(".") for full in raised):
            report.add("nothing lost", kind, name, text)
    names = _node_names(circuit, network)
    effects, after = loss_effects(circuit, report.findings, before, names) if before else ((), None)
    return Imported(
        network,
        report.findings,
        _per_unit(before, names),
        _per_unit(after, names),
        effects,
        digests(circuit.files, folder or Path(master).parent),
        circuit.engine.Basic.Version().partition(" revision")[0],
        profiles,
    )


def _node_names(circuit: DssCircuit, network: Network) -> dict[str, tuple[str, float]]:
    """Name and base voltage to ground, V, of the nodes that the tables and OpenDSS have, by OpenDSS's name."""
    letters, node = Letters(circuit.node_numbers()), network.node
    ours = {
        f"{bus}.{LETTERS[phase - 1]}": 1000.0 * kv
        for bus, phase, kv in zip(node.bus, node.phase, node.base_kv_ln, strict=True)
    }
    names = {}
    for full in circuit.volts():
        bus, _, number = full.rpartition(".")
        name = f"{bus}.{letters[int(number)]}"
        if name in ours:
            names[full] = (name, ours[name])
    return names


def _per_unit(solution: Solved | None, names: dict[str, tuple[str, float]]) -> dict[str, complex]:
    volts = solution.volts if solution else {}
    v_pu = {name: volts[full] / base_v for full, (name, base_v) in names.items() if full in volts}
    return v_pu if all(math.isfinite(abs(v)) for v in v_pu.values()) else {}


def digests(files: Iterable[Path], folder: str | Path) -> tuple[tuple[str, str], ...]:
    """Name below the folder and SHA-256 of each file."""
    folder = Path(folder).resolve()
    return tuple((path.resolve().relative_to(folder).as_posix(), sha256_of(path)) for path in files)


class _Reading:
    """One reading of a solved circuit into tables, with its report.

    ``derived`` is the result of ``derive_bases``. ``generic`` are elements, as class.name, that become rows of the
    admittances.
    """

    def __init__(
        self,
        circuit: DssCircuit,
        master: Path,
        root: Path | None,
        allow: Collection[str],
        derived: tuple[int, list[float]],
        generic: Sequence[str] = (),
    ) -> None:
        self._circuit, self._script, self._allow, self._generic = circuit, master.name, allow, generic
        self.report = report = Report()
        self._ratings, self._shapes = ScriptRatings(circuit, master, report, root), LoadShapes(circuit, report)
        self.profiles: tuple[ImportedProfiles, ...] = ()
        self.members: dict[str, list[tuple[str, ...]]] = {}
        """Elements, as class.name, that each row of a table is, by table and row."""
        for command, where in circuit.skipped:
            report.add("nothing lost", "command", f"{command} ({where})", "it shows or writes results: it is left out")
        report.add_all("nothing lost", "command", [f"solve ({where})" for where in circuit.unsettled], _UNSETTLED)
        number, bases = derived
        if number:
            text = "the script sets no base voltages here: they are the nearest of the voltages of source and windings"
            report.add("nothing lost", "bus", f"{number} buses, from {', '.join(f'{kv:.6g}' for kv in bases)} kV", text)

    def network(self) -> tuple[Network, list[str]]:
        """The tables, and the elements, as class.name, whose rows have other admittances than OpenDSS."""
        circuit, report, ratings, generic = self._circuit, self.report, self._ratings, self._generic
        source, source_bus = read_source(circuit, report)
        letters = Letters(circuit.node_numbers())
        if letters.beyond:
            renamed = ", ".join(f"{number} is {letters[number]}" for number in letters.beyond)
            report.add("nothing lost", "node", "numbers beyond 26", f"they have unused letters: {renamed}")
        lines, units = read_lines(circuit, report, ratings, letters, generic), read_units(circuit, ratings, generic)
        steps = capacitor_steps(circuit, letters, generic)
        lines += capacitor_admittances(circuit, report, letters, steps)
        joints = [*lines, *_unit_joints(circuit, letters, units)]
        supply = supply_of(source_bus, joints, list(_leg_nodes(circuit, letters, steps)))
        lines = _with_supply(lines, supply, report)
        tables = _Tables(circuit, report, supply, letters, ratings)
        for name, unit in units.items():
            tables.add(name, unit, tables.regulations.pop(name.lower(), None))
        for regulation in tables.regulations.values():
            fate = "nothing lost" if regulation.is_fixed else "lost"
            report.add(fate, "regcontrol", regulation.name, "its transformer is not in the tables")
        generation = read_generation(circuit, report, supply, letters)
        loads = [*read_loads(circuit, report, supply, letters, self._shapes), *generation]
        self.profiles = self._shapes.profiles()
        capacitors, step_rows = read_capacitors(circuit, report, supply, steps, fixed_capacitors(circuit, report))
        capacitor_controls = read_capacitor_controls(circuit, report, supply, letters, lines, step_rows)
        transformers = merged(tables.transformers, report)
        report_the_rest(circuit, report)
        report.refuse_unless(circuit.name, self._allow)
        rows = {
            "phase_line": _rows(lines, "phase_line"),
            "switch": _rows(lines, "switch"),
            "transformer": _rows(transformers, "transformer"),
            "regulator": tables.regulators,
            "capacitor": capacitors,
            "core": tables.cores,
            "admittance": _admittance_rows([*lines, *tables.admittances]),
        }
        network = Network(
            name=circuit.name,
            source=source,
            node=_nodes(circuit, supply, tables.between, letters),
            phase_line=_table(PhaseLineTable, rows["phase_line"]),
            switch=_table(SwitchTable, rows["switch"]),
            transformer=_table(TransformerTable, rows["transformer"]),
            regulator=_table(RegulatorTable, rows["regulator"]),
            phase_load=_table(PhaseLoadTable, loads),
            capacitor=_table(CapacitorTable, rows["capacitor"]),
            capacitor_control=_table(CapacitorControlTable, capacitor_controls),
            core=_table(CoreTable, rows["core"]),
            admittance=_table(AdmittanceTable, rows["admittance"]),
            frequency_hz=float(circuit.engine.Solution.Frequency()),
            source_of_facts=f"OpenDSS script {self._script}",
        )
        self.members = {kind: [tuple(row["members"]) for row in of_kind] for kind, of_kind in rows.items()}
        unlike = unlike_elements(circuit, letters, network, self.members, tables.between)
        return with_further_ratings(network, circuit, ratings, report), unlike


def _leg_nodes(circuit: DssCircuit, letters: Letters, steps: Mapping[str, list[Legs] | None]) -> Iterable[list[Node]]:
    """Nodes of each leg of what draws or injects."""
    for kind in ("load", *GENERATION):
        for name in circuit.names(kind):
            circuit.activate(kind, name)
            end, size = circuit.terminals()[0], circuit.engine.CktElement.NumPhases()
            for leg in legs_between(end, letters, size, circuit.text("conn").lower() in ("delta", "ll")) or ():
                yield [(end.bus, letter) for letter in leg]
    for name, of_steps in steps.items():
        circuit.activate("capacitor", name)
        bus = circuit.terminals()[0].bus
        for leg in (leg for legs in of_steps or () for leg in legs):
            yield [(bus, letter) for letter in leg]


def _unit_joints(circuit: DssCircuit, letters: Letters, units: dict[str, Unit | str]) -> Iterable[Joint]:
    """What the transformers connect."""
    for name, unit in units.items():
        if isinstance(unit, Unit):
            yield Joint("unit", name, tuple(winding.bus for winding in unit.windings), unit.phases, True)
        else:
            joint = admittance_joint(circuit, letters, "transformer", name)
            if isinstance(joint, Joint):
                yield joint


def _with_supply(lines: Sequence[Joint], supply: Supply, report: Report) -> list[Joint]:
    kept = []
    for line in lines:
        if supply.is_fed(line):
            kept.append(part_with_supply(line, supply, report) if line.kind == "admittance" else line)
        else:
            for kind, _, name in (full.partition(".") for full in line.members):
                report.withdraw(kind, [name])
            fate = "lost" if line.closed else "nothing lost"
            kind = "" if line.kind == "admittance" else "line "
            report.add(fate, "isolated", f"{kind}{line.name}", "without supply at an end: it is left out")
    return kept


class _Tables:
    """Transformers and regulators as they are sorted, with the buses that come between them."""

    def __init__(
        self, circuit: DssCircuit, report: Report, supply: Supply, letters: Letters, ratings: ScriptRatings
    ) -> None:
        self.circuit, self.letters, self.ratings = circuit, letters, ratings
        self.report, self.supply = report, supply
        self.regulations = read_regulations(circuit, report, supply, letters)
        self.transformers: list[Joint] = []
        self.admittances: list[Joint] = []
        self.regulators: list[Row] = []
        self.cores: list[Row] = []
        self.between: dict[str, tuple[str, str]] = {}
        """Phases of each bus that was put in, and the bus whose base voltage and coordinates it has."""

    def add(self, name: str, unit: Unit | str, regulation: Regulation | None) -> None:
        """Take a transformer, with its control if it has one."""
        report, supply = self.report, self.supply
        self.circuit.activate("transformer", name)
        if not all(end.bus in supply.depth for end in self.circuit.terminals()):
            report.add("lost", "isolated", f"transformer {name}", "without supply: it is left out")
            return
        if isinstance(unit, str):
            self._add_admittance(name, unit, None if regulation and regulation.is_fixed else regulation)
            return
        tapped = unit.windings[regulation.winding - 1] if regulation else None
        cores, unit = core_rows(unit, report), oriented(unit, supply.depth)
        if regulation and tapped and regulation.is_fixed and not has_row(unit, tapped, regulation):
            regulation = None  # a transformer holds any fixed tap
        between = unit.windings[0].connection == "between"
        if between and not (regulation and tapped is unit.windings[1] and is_regulator(unit)):
            self._add_admittance(name, "its windings stand between two phases", regulation)
            return
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
            self._add_admittance(name, joint, regulation)
            return
        self.cores += cores
        if joint:
            self.transformers.append(joint)
            report.add("taken", "transformer", unit.name, "in transformers.csv")
        else:
            manner = "at its fixed tap" if regulation and regulation.is_fixed else "with its control"
            report.add("taken", "transformer", unit.name, f"in regulators.csv, {manner}")
        row = regulator_row(unit, regulation, joint.ends[1] if joint else first.bus, report) if regulation else None
        self.regulators += [row] if row else []

    def _add_admittance(self, name: str, reason: str, regulation: Regulation | None) -> None:
        """Take a transformer as an admittance; its tap is fixed unless a regulator can represent it."""
        report, circuit = self.report, self.circuit
        rating_a = fed_side_rating(circuit, self.ratings, name, self.supply.depth)
        if regulation:
            circuit.activate("transformer", name)
            ends, k = circuit.terminals(), regulation.winding - 1
            between = f"{ends[0 if k else -1].bus}-{ends[k].bus}"
            representation = regulated_admittance(circuit, self.letters, name, regulation, between)
            if not isinstance(representation, str):
                joint, unit, connection = representation
                unit = replace(unit, rating_kva=self.ratings.of_transformer(name))
                row = regulator_row(unit, regulation, between, report, connection)
                if row:
                    self._put_between(between, unit.phases, ends[k].bus)
                    self.regulators.append(row)
                    joint.values["rating_a"] = rating_a
                    self.admittances.append(joint)
                    report.add("taken", "transformer", name, f"in admittances.csv: {reason}")
                return
            report.add("lost", "regcontrol", regulation.name, f"{representation}: its tap is fixed")
        joint = admittance_joint(circuit, self.letters, "transformer", name, rating_a)
        report_admittance(report, "transformer", name, joint, reason)
        self.admittances += [part_with_supply(joint, self.supply, report)] if isinstance(joint, Joint) else []

    def _between(self, unit: Unit) -> str:
        first, second = unit.windings
        bus = f"{first.bus}-{second.bus}"
        self._put_between(bus, unit.phases, second.bus)
        return bus

    def _put_between(self, bus: str, phases: str, like: str) -> None:
        had = self.between.get(bus, ("", ""))[0]
        self.between[bus] = ("".join(sorted(set(had + phases))), like)


def _admittance_rows(joints: Iterable[Joint]) -> list[Row]:
    return [
        {"name": joint.name, **joint.values, "members": joint.members} for joint in joints if joint.kind == "admittance"
    ]


def _nodes(circuit: DssCircuit, supply: Supply, between: dict[str, tuple[str, str]], letters: Letters) -> NodeTable:
    rows: list[tuple[Any, ...]] = []
    fed_buses = {bus: (phases, bus) for bus, phases in supply.phases.items()}
    for bus, (phases, like) in (fed_buses | between).items():
        base_kv, (x, y) = circuit.base_kv_ln(like), circuit.coordinates(like)
        if not base_kv > 0:
            raise FeederError(
                f"circuit {circuit.name!r}: bus {bus} has no base voltage, and none can be derived from the source and "
                "the transformers; add Set VoltageBases=[..] and CalcVoltageBases to the script"
            )
        if not (math.isfinite(x) and math.isfinite(y)):
            x = y = math.nan
        rows += [(bus, LETTERS.index(letter) + 1, x, y, base_kv) for letter in phases]
    return NodeTable(*zip(*rows, strict=True))


def _rows(joints: Iterable[Joint], kind: str) -> list[Row]:
    return [
        {"name": joint.name, "from_bus": joint.ends[0], "to_bus": joint.ends[1], "phases": joint.phases, **joint.values,
         "members": joint.members}
        for joint in joints
        if joint.kind == kind
    ]  # fmt: skip


def _table(table: type[Any], rows: Sequence[Row]) -> Any:
    """A table out of its rows; each has every column. Ratings that say nothing are left out."""
    columns = {field.name: tuple(row[field.name] for row in rows) for field in dataclasses.fields(table)}
    return table(**{name: values for name, values in columns.items() if not says_nothing(name, columns)})
