"""Transformers of an OpenDSS circuit; those with a RegControl go on to ``dss_regulators``.

Those of two windings that a table can hold are units. The others become rows of the admittances.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace

from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.opendss.dss_circuit import DssCircuit, Terminal
from dcgrid_env.apps.importers.opendss.dss_lines import UNLIKE, rounded
from dcgrid_env.apps.importers.opendss.dss_ratings import ScriptRatings
from dcgrid_env.apps.importers.opendss.joints import Joint
from dcgrid_env.grid.three_phase_tables import WINDINGS

_SIZES = {"kva": 0.0, "rating_kva": 0.0}
"""Columns that are summed when two transformers between the same buses become one row."""


@dataclass(frozen=True)
class Winding:
    """One winding: its bus, its connection in the tables' words, and its figures."""

    bus: str
    connection: str
    kv_ll: float
    tap: float
    tap_min: float
    tap_max: float
    n_tap: int


@dataclass(frozen=True)
class Unit:
    """A transformer of one to three phases, its windings in OpenDSS's order."""

    name: str
    phases: str
    """Phases of its windings; both phases of a winding that connects two."""
    nodes: tuple[int, ...]
    windings: tuple[Winding, Winding]
    kva: float
    rating_kva: float
    """Rating of the smaller winding at its rated voltage; NaN where the script gives none."""
    r_percent: float
    x_percent: float
    lag: bool
    """Whether the low side lags, as ANSI has it."""
    antifloat_ppm: float
    no_load_percent: float
    magnetising_percent: float
    bank: str


def read_units(circuit: DssCircuit, ratings: ScriptRatings, generic: Collection[str]) -> dict[str, Unit | str]:
    """Each transformer by name, or why it is to be a row of the admittances, as those in ``generic`` are."""
    return {
        name: UNLIKE if f"transformer.{name}" in generic else _unit(circuit, ratings, name)
        for name in circuit.names("transformer")
    }


def fed_side_rating(circuit: DssCircuit, ratings: ScriptRatings, name: str, depth: dict[str, int]) -> float:
    """Rated current of a transformer of any windings at the bus that it feeds, A; NaN where it is not known.

    The windings of one phase to that bus are in series, as the two halves of a split-phase transformer are.
    """
    rating_kva = ratings.of_transformer(name)
    circuit.activate("transformer", name)
    buses, size = [end.bus for end in circuit.terminals()], circuit.engine.CktElement.NumPhases()
    fed_bus = max(buses, key=lambda bus: depth.get(bus, 0))
    kvs = [kv for kv, bus in zip(circuit.figures("kvs"), buses, strict=True) if bus == fed_bus]
    volts = sum(kvs) if size == 1 else math.sqrt(3.0) * max(kvs) * size / 3.0
    return rating_kva / volts


def _unit(circuit: DssCircuit, ratings: ScriptRatings, name: str) -> Unit | str:
    circuit.activate("transformer", name)
    ends = circuit.terminals()
    if len(ends) != 2:
        return f"it has {len(ends)} windings"
    if any(any(phases) for phases in circuit.open_conductors()):
        return "a terminal is open"
    engine = circuit.engine
    engine.Transformers.Name(name)
    size = engine.CktElement.NumPhases()
    windings, resistance = [], 0.0
    for k, end in enumerate(ends):
        engine.Transformers.Wdg(k + 1)
        delta = bool(engine.Transformers.IsDelta())
        wrong = _wrong_winding(end, delta, size)
        if wrong:
            return f"winding {k + 1} {wrong}"
        kv = float(engine.Transformers.kV()) * (math.sqrt(3.0) if size == 1 else 1.0)
        taps = engine.Transformers
        windings.append(
            Winding(end.bus, _connection(end, delta, size), kv, float(taps.Tap()), float(taps.MinTap()),
                    float(taps.MaxTap()), int(taps.NumTaps()))
        )  # fmt: skip
        resistance += float(engine.Transformers.R())
    between = [winding.connection == "between" for winding in windings]
    if any(between) and not all(between):
        return "one of its windings stands between two phases"
    nodes = [end.nodes[: size + any(between)] for end in ends]
    turned = (1, 2, 3), (2, 3, 1), (3, 1, 2)
    if nodes[0] != nodes[1] or (size == 3 and "delta" in {w.connection for w in windings} and nodes[0] not in turned):
        return "its phases change, or are not in the order 1 2 3"
    rating_kva = ratings.of_transformer(name)
    circuit.activate("transformer", name)
    # Reactances hold at the frequency of the transformer.
    higher = float(engine.Solution.Frequency()) / circuit.figure("basefreq")
    return Unit(
        name, "".join("abc"[node - 1] for node in sorted(nodes[0])), nodes[0], (windings[0], windings[1]),
        circuit.figures("kvas")[0], rating_kva, rounded(resistance), rounded(circuit.figure("xhl") * higher),
        circuit.text("leadlag").lower() in ("lag", "ansi"),
        circuit.figure("ppm_antifloat"), circuit.figure("%noloadloss"), circuit.figure("%imag") / higher,
        circuit.text("bank"),
    )  # fmt: skip


def _wrong_winding(end: Terminal, delta: bool, size: int) -> str:
    phases, rest = end.nodes[:size], end.nodes[size:]
    if not set(phases) <= {1, 2, 3} or len(set(phases)) < size:
        return "has other nodes than one for each of its phases"
    if delta and size == 3:
        return ""
    if any(rest) and not (size == 1 and set(rest) <= {1, 2, 3} - set(phases)):
        return "has a neutral that is not at ground"
    return "is a delta of two phases" if delta and size == 2 else ""


def _connection(end: Terminal, delta: bool, size: int) -> str:
    if size == 1 and any(end.nodes[1:]):
        return "between"
    return "delta" if delta and size == 3 else "wye_grounded"


def oriented(unit: Unit, depth: dict[str, int]) -> Unit:
    """The transformer with its fed winding first."""
    first, second = unit.windings
    return unit if depth[first.bus] <= depth[second.bus] else replace(unit, windings=(second, first))


def transformer_joint(unit: Unit, to_bus: str, to_tap: float) -> Joint | str:
    """The row of a transformer whose fed winding comes first, its taps taken into its voltages; or what is wrong.

    Its rating is then at those voltages: neither winding carries more than its rated current.
    """
    first, second = unit.windings
    pair = (first.connection, second.connection)
    if pair not in WINDINGS:
        return f"it is {' / '.join(pair)} from its fed side"
    shift_deg = 0.0
    if pair == ("delta", "wye_grounded"):
        steps_down = first.kv_ll >= second.kv_ll
        shift_deg = -30.0 if unit.lag == steps_down else 30.0
    values = {
        "connection_from": pair[0], "connection_to": pair[1], "kva": rounded(unit.kva),
        "kv_ll_from": rounded(first.kv_ll * first.tap), "kv_ll_to": rounded(second.kv_ll * to_tap),
        "r_percent": unit.r_percent, "x_percent": unit.x_percent, "shift_deg": shift_deg,
        "antifloat_ppm": unit.antifloat_ppm, "rating_kva": rounded(unit.rating_kva * min(first.tap, to_tap)),
    }  # fmt: skip
    members = (f"transformer.{unit.name}",)
    return Joint("transformer", unit.name, (first.bus, to_bus), unit.phases, True, values, members=members)


def merged(joints: list[Joint], report: Report) -> list[Joint]:
    """Transformers of one kind between the same two buses made one: of single phases, or in parallel."""
    joints_by_ends: dict[object, Joint] = {}
    for joint in joints:
        other = joints_by_ends.get(joint.ends)
        if other is None:
            joints_by_ends[joint.ends] = joint
            continue
        phases = "".join(sorted(set(other.phases + joint.phases)))
        added = {field: rounded(other.values[field] + joint.values[field]) for field in _SIZES}
        parallel = other.phases == joint.phases
        beside = len(phases) == len(other.phases + joint.phases) and math.isclose(
            other.values["kva"] / len(other.phases), joint.values["kva"] / len(joint.phases)
        )
        if other.values | _SIZES != joint.values | _SIZES or not (parallel or beside):
            joints_by_ends[joint.name] = joint
            continue
        text = "beside each other between two buses: one row that is both"
        report.add("nothing lost", "transformer", f"{other.name} and {joint.name}", text)
        joints_by_ends[joint.ends] = replace(
            other, name=f"{other.name}+{joint.name}", phases=phases, values=joint.values | added,
            members=(*other.members, *joint.members),
        )  # fmt: skip
    return list(joints_by_ends.values())
