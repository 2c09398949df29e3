"""Checks of a three-phase grid's tables: each refusal names the feeder, the component, the field and its value."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from typing import Any

from dcgrid_env.grid.network import Network
from dcgrid_env.grid.network_checks import check_numbers
from dcgrid_env.grid.seasonal_ratings import check_ratings
from dcgrid_env.grid.three_phase_tables import (
    CONNECTIONS,
    CONTROL_MEASURES,
    LETTERS,
    LOAD_MODELS,
    RATINGS,
    STATISTICS,
    WINDINGS,
    Matrix,
)
from dcgrid_env.grid.topology import FeederError

PHASES = ("a", "b", "c", "ab", "ac", "bc", "abc")
SHIFTS = {WINDINGS[0]: (0.0,), WINDINGS[1]: (-30.0, 30.0), WINDINGS[2]: (0.0,)}
TABLES = ("phase_line", "switch", "transformer", "regulator", "phase_load", "capacitor", "core", "admittance")
TABLES += ("capacitor_control",)
_SAME_BASE = 1e-9  # relative
FAR = 10.0
"""A rated voltage this many times the base voltage of its bus, or this much less, is in another unit or misplaced."""
LEAST_KVA = 1e-6
"""Smallest rated power of a transformer or regulator, kVA."""


def check_three_phase(network: Network) -> None:
    """Raise FeederError unless every cell is valid and the buses of every component have its phases.

    ``three_phase_tree`` checks that every bus is connected, and on radial grids that it is fed from the right side.
    """
    for kind in ("line", "load", "shunt"):
        if len(getattr(network, kind)):
            raise FeederError(
                f"feeder {network.name!r}: the table {kind} is of balanced feeders; a three-phase feeder has "
                f"{', '.join(TABLES)}"
            )
    buses = _check_nodes(network)
    _check_source(network, buses)
    for kind in TABLES:
        _check_names(network, kind)
    for kind in TABLES[:4]:
        _check_ends(network, kind, buses)
    _check_branches(network)
    _check_windings(network, buses)
    _check_regulators(network, buses)
    _check_loads(network, buses)
    _check_capacitors(network, buses)
    _check_capacitor_controls(network, buses)
    _check_cores(network, buses)
    _check_admittances(network, buses)
    check_ratings(network)


def _refuse(network: Network, component: str, field: str, value: object, remedy: str) -> FeederError:
    return FeederError(f"feeder {network.name!r}: {component}: {field} is {value!r}; {remedy}")


def _words(kind: str) -> str:
    return {"phase_line": "line", "phase_load": "load", "capacitor_control": "capacitor control"}.get(kind, kind)


def _check_sizes(network: Network, kind: str, field: str) -> None:
    """Refuse rated powers whose impedance would be infinite."""
    table = getattr(network, kind)
    for one, kva in zip(table.name, getattr(table, field), strict=True):
        if kva < LEAST_KVA:
            raise _refuse(network, f"{kind} {one}", field, kva, f"give at least {LEAST_KVA:g} kVA")


def _numbers(network: Network, kind: str, fields: Sequence[str], **rules: bool) -> None:
    table = getattr(network, kind)
    check_numbers(network.name, _words(kind), table.name, {f: getattr(table, f) for f in fields}, **rules)


def _check_nodes(network: Network) -> dict[str, tuple[str, float]]:
    """Phases, as a text, and base voltage of each bus."""
    node = network.node
    if len(node.base_kv_ln) != len(node):
        raise FeederError(f"feeder {network.name!r}: {len(node.base_kv_ln)} values of base_kv_ln for {len(node)} nodes")
    ids = [f"{bus}.{phase}" for bus, phase in zip(node.bus, node.phase, strict=True)]
    check_numbers(network.name, "node", ids, {"base_kv_ln": node.base_kv_ln}, positive=True)
    check_numbers(network.name, "node", ids, {"x": node.x, "y": node.y}, may_be_nan=True)
    buses: dict[str, tuple[str, float]] = {}
    last = None
    for k, (bus, phase, base_kv) in enumerate(zip(node.bus, node.phase, node.base_kv_ln, strict=True)):
        if phase not in range(1, len(LETTERS) + 1):
            remedy = "give 1, 2 or 3 for a, b or c, or up to 26 for other conductors"
            raise _refuse(network, f"node at bus {bus}", "phase", phase, remedy)
        had, of_bus = buses.get(bus, ("", base_kv))
        if bus in buses and (bus != last or LETTERS[phase - 1] <= had[-1]):
            raise _refuse(network, f"bus {bus}", "phase", phase, "give each phase once, in order, in rows together")
        if base_kv != of_bus or (had and repr((node.x[k], node.y[k])) != repr((node.x[k - 1], node.y[k - 1]))):
            raise _refuse(network, f"bus {bus}", "base_kv_ln, x or y", base_kv, "give all phases of a bus the same")
        buses[bus], last = (had + LETTERS[phase - 1], base_kv), bus
    return buses


def _check_source(network: Network, buses: dict[str, tuple[str, float]]) -> None:
    name, source = network.name, network.source
    if len(source) != 1:
        raise FeederError(f"feeder {name!r}: {len(source)} sources; give one")
    bus = source.bus[0]
    if bus not in buses:
        raise _refuse(network, "source", "bus", bus, "add it to the nodes")
    if not buses[bus][0].startswith("abc"):
        raise _refuse(network, f"source bus {bus}", "phases", buses[bus][0], "it must have a, b and c")
    values = {"base_kv": source.base_kv, "v_pu": source.v_pu}
    check_numbers(name, "source", [bus], values, positive=True)
    for field in ("angle_deg", "r_ohm", "x_ohm"):
        if len(getattr(source, field)) != 1:
            raise _refuse(network, "source", field, getattr(source, field), "give one")
    check_numbers(name, "source", [bus], {"angle_deg": source.angle_deg})
    check_numbers(name, "feeder", ["frequency"], {"frequency_hz": [network.frequency_hz]}, positive=True)
    _check_matrix(network, "source", "r_ohm", source.r_ohm[0], "abc", non_negative=True)
    _check_matrix(network, "source", "x_ohm", source.x_ohm[0], "abc")


def _check_matrix(
    network: Network, component: str, field: str, matrix: Matrix, phases: str, non_negative: bool = False
) -> None:
    """FeederError unless 3x3, symmetric, finite where both phases exist and NaN where one does not."""
    if not isinstance(matrix, tuple) or [len(r) if isinstance(r, tuple) else 0 for r in matrix] != [3, 3, 3]:
        raise _refuse(network, component, field, matrix, "give three rows of three figures")
    for i, a in enumerate("abc"):
        for j, b in enumerate("abc"):
            value, there = matrix[i][j], a in phases and b in phases
            entry = f"{field} {a}{b}"
            if not there:
                if not (isinstance(value, float) and math.isnan(value)):
                    raise _refuse(network, component, entry, value, f"its phases are {phases}: leave it empty (NaN)")
                continue
            check_numbers(network.name, component, [entry], {"value": [value]}, non_negative=non_negative and i == j)
            if value != matrix[j][i]:
                raise _refuse(network, component, entry, value, f"not symmetric: {b}{a} is {matrix[j][i]!r}")


def _check_names(network: Network, kind: str) -> None:
    table: Any = getattr(network, kind)
    used: set[str] = set()
    for one in table.name:
        if not isinstance(one, str) or not one or one in used:
            raise _refuse(network, _words(kind), "name", one, "give each its own text")
        used.add(one)
    for field in dataclasses.fields(table):
        values, choices = getattr(table, field.name), _CHOICES.get(field.name, ())
        if kind == "switch" and field.name == "state":
            choices = ("closed", "open")
        named = field.name == "connection"
        for one, value in zip(table.name, values, strict=True) if choices and values else ():
            if value not in choices and not (named and _names_legs(value)):
                others = " or up to three legs such as 'ad bd cd'" if named else ""
                remedy = f"choose {', '.join(choices)}{others}"
                raise _refuse(network, f"{_words(kind)} {one}", field.name, value, remedy)


def _names_legs(connection: object) -> bool:
    """Whether a connection names legs of one or two conductors each."""
    words = connection.split() if isinstance(connection, str) else []
    good = (set(word) <= set(LETTERS) and len(set(word)) == len(word) <= 2 for word in words)
    return 0 < len(words) <= 3 and len(set(words)) == len(words) and all(good)


_CHOICES: dict[str, tuple[str, ...]] = {
    "phases": PHASES,
    "connection": CONNECTIONS,
    "model": LOAD_MODELS,
    "state": ("on", "off"),
    "sensed_phase": ("a", "b", "c"),
    "measures": CONTROL_MEASURES,
    "legs_of": STATISTICS,
    "phases_of": STATISTICS,
}


def _check_ends(network: Network, kind: str, buses: dict[str, tuple[str, float]]) -> None:
    table: Any = getattr(network, kind)
    for one, i, j, phases in zip(table.name, table.from_bus, table.to_bus, table.phases, strict=True):
        subject = f"{_words(kind)} {one}"
        for field, bus in (("from_bus", i), ("to_bus", j)):
            if bus not in buses:
                raise _refuse(network, subject, field, bus, "no such bus; add it to the nodes")
            if not set(phases) <= set(buses[bus][0]):
                raise _refuse(network, subject, "phases", phases, f"bus {bus} has phases {buses[bus][0]} alone")
        if kind != "transformer" and abs(buses[i][1] - buses[j][1]) > _SAME_BASE * buses[i][1]:
            raise _refuse(network, subject, "base_kv_ln of its ends", (buses[i][1], buses[j][1]), "they must agree")


def _check_branches(network: Network) -> None:
    line = network.phase_line
    for k, one in enumerate(line.name):
        for field in ("r_ohm", "x_ohm", "b_us"):
            matrix = getattr(line, field)[k]
            _check_matrix(network, f"line {one}", field, matrix, line.phases[k], non_negative=field == "r_ohm")
    _numbers(network, "phase_line", ["length_m"], may_be_nan=True)
    for kind, rating in RATINGS.items():
        if getattr(getattr(network, kind), rating):
            _numbers(network, kind, [rating], positive=True, may_be_nan=True)
    _numbers(network, "switch", ["r_ohm", "x_ohm"], non_negative=True)
    _numbers(network, "transformer", ["kva", "kv_ll_from", "kv_ll_to"], positive=True)
    _check_sizes(network, "transformer", "kva")
    _numbers(network, "transformer", ["r_percent", "x_percent", "antifloat_ppm"], non_negative=True)
    _numbers(network, "transformer", ["shift_deg"])
    table = network.transformer
    rows = zip(table.name, table.connection_from, table.connection_to, table.shift_deg, table.phases, strict=True)
    for one, i, j, shift_deg, phases in rows:
        if (i, j) not in WINDINGS:
            known = ", ".join(" / ".join(pair) for pair in WINDINGS)
            raise _refuse(network, f"transformer {one}", "connection_from, connection_to", (i, j), f"choose {known}")
        if shift_deg not in SHIFTS[i, j]:
            wanted = " or ".join(f"{s:g}" for s in SHIFTS[i, j])
            raise _refuse(network, f"transformer {one}", "shift_deg", shift_deg, f"{i} / {j} takes {wanted}")
        if phases != "abc" and i == "delta":
            raise _refuse(network, f"transformer {one}", "phases", phases, "a delta winding needs abc")


def _check_regulators(network: Network, buses: dict[str, tuple[str, float]]) -> None:
    _numbers(network, "regulator", ["kv_ln", "kva_per_phase", "tap_step", "pt_ratio", "ct_primary_a"], positive=True)
    _check_sizes(network, "regulator", "kva_per_phase")
    not_negative = ["r_percent", "x_percent", "antifloat_ppm", "vreg_v", "band_v", "delay_s", "tap_delay_s"]
    _numbers(network, "regulator", [*not_negative, "max_taps_per_move"], non_negative=True)
    _numbers(network, "regulator", ["r_ldc_v", "x_ldc_v", "tap", "tap_neutral", "tap_min", "tap_max"])
    if network.regulator.z_ldc_v:
        _numbers(network, "regulator", ["z_ldc_v"], non_negative=True)
    table = network.regulator
    for k, one in enumerate(table.name):
        subject, lowest, highest = f"regulator {one}", table.tap_min[k], table.tap_max[k]
        for field in ("tap", "tap_neutral", "tap_min", "tap_max", "max_taps_per_move"):
            if getattr(table, field)[k] != int(getattr(table, field)[k]):
                raise _refuse(network, subject, field, getattr(table, field)[k], "give a whole number")
        for field in ("tap", "tap_neutral"):
            if not lowest <= getattr(table, field)[k] <= highest:
                raise _refuse(
                    network, subject, field, getattr(table, field)[k], f"it must be from {lowest} to {highest}"
                )
        if table.tap_step[k] * max(abs(lowest), abs(highest)) >= 1.0:
            raise _refuse(network, subject, "tap_step", table.tap_step[k], "a tap would turn the voltage round")
        if not isinstance(table.bank[k], str):
            raise _refuse(network, subject, "bank", table.bank[k], "give a text")
        windings = table.windings(k)
        if table.connection and table.connection[k] == "delta" and len(table.phases[k]) != 2:
            raise _refuse(network, subject, "phases", table.phases[k], "a regulator between two phases has two")
        letters = "".join(sorted(set("".join(at_from for at_from, _ in windings))))
        if letters != table.phases[k]:
            raise _refuse(network, subject, "connection", table.connection[k], f"its phases are {table.phases[k]}")
        there = buses[table.to_bus[k]][0]
        if not set("".join(at_to for _, at_to in windings)) <= set(there):
            raise _refuse(network, subject, "connection", table.connection[k], f"its to_bus has phases {there}")
        sensed = table.relay_bus(k)
        at_winding = sensed == table.to_bus[k]
        if sensed not in buses:
            raise _refuse(network, subject, "sensed_bus", sensed, "no such bus; add it to the nodes, or leave it empty")
        sensed_phases = table.phases[k] if at_winding else buses[sensed][0]
        if table.sensed_phase[k] not in sensed_phases:
            raise _refuse(network, subject, "sensed_phase", table.sensed_phase[k], f"its phases are {sensed_phases}")
        compensation = (table.r_ldc_v[k], table.x_ldc_v[k], table.z_ldc_v[k] if table.z_ldc_v else 0.0)
        if (any(compensation) and not at_winding) or (any(compensation[:2]) and compensation[2]):
            remedy = "with sensed_bus all are 0" if not at_winding else "with z_ldc_v the others are 0"
            raise _refuse(network, subject, "r_ldc_v, x_ldc_v, z_ldc_v", compensation, remedy)


def _near(kv: float, base_kv_ln: float) -> bool:
    return 1.0 / FAR < kv / base_kv_ln < FAR


def _check_voltage(network: Network, subject: str, field: str, kv: float, base_kv_ln: float) -> None:
    """Raise FeederError for a rated voltage that is far from its bus's base, line to neutral."""
    if not _near(kv, base_kv_ln):
        raise _refuse(
            network, subject, field, kv, f"far from the {base_kv_ln:g} kV (line to neutral) of its bus; give kV"
        )


def _check_windings(network: Network, buses: dict[str, tuple[str, float]]) -> None:
    table = network.transformer
    for k, one in enumerate(table.name):
        from_kv, to_kv = (buses[bus][1] for bus in (table.from_bus[k], table.to_bus[k]))
        if _near(table.kv_ll_from[k], to_kv) and _near(table.kv_ll_to[k], from_kv):
            continue  # it stands the wrong way round, which is said where the tree is made
        for bus, field in ((table.from_bus[k], "kv_ll_from"), (table.to_bus[k], "kv_ll_to")):
            _check_voltage(network, f"transformer {one}", field, getattr(table, field)[k], buses[bus][1])


def legs_of(connection: str) -> tuple[str, ...]:
    """The conductors that the three legs of a connection join: one, to ground, or two; none where there are fewer."""
    known = {"wye": ("a", "b", "c"), "delta": ("ab", "bc", "ca")}
    return known.get(connection) or (*connection.split(), "", "")[:3]


def _check_legs(network: Network, kind: str, fields: Sequence[str], buses: dict[str, tuple[str, float]]) -> None:
    table: Any = getattr(network, kind)
    for k, one in enumerate(table.name):
        subject = f"{_words(kind)} {one}"
        if table.bus[k] not in buses:
            raise _refuse(network, subject, "bus", table.bus[k], "no such bus; add it to the nodes")
        _check_voltage(network, subject, "leg_kv", table.leg_kv[k], buses[table.bus[k]][1])
        for field in fields:
            values = getattr(table, field)[k]
            if not isinstance(values, tuple) or len(values) != 3:
                raise _refuse(network, subject, field, values, "give one figure for each of three legs")
            check_numbers(network.name, _words(kind), [one] * 3, {field: values}, non_negative=kind != "phase_load")
            for leg, value in zip(legs_of(table.connection[k]), values, strict=True):
                phases = buses[table.bus[k]][0]
                if value != 0 and not (leg and set(leg) <= set(phases)):
                    there = f"its bus has phases {phases}" if leg else "its connection has no such leg"
                    raise _refuse(network, subject, f"{field} of leg {leg}", value, there)


def _check_loads(network: Network, buses: dict[str, tuple[str, float]]) -> None:
    _numbers(network, "phase_load", ["leg_kv", "vmin_pu", "vmax_pu", "vlow_pu"], positive=True)
    _check_legs(network, "phase_load", ["p_kw", "q_kvar"], buses)
    table = network.phase_load
    for k, one in enumerate(table.name):
        limits = (table.vlow_pu[k], table.vmin_pu[k], table.vmax_pu[k])
        if not limits[0] < limits[1] < limits[2]:
            raise _refuse(network, f"load {one}", "vlow_pu, vmin_pu, vmax_pu", limits, "they must rise")
        shares, exponents = table.zip[k], table.exponents[k] if table.exponents else ()
        if len(exponents) != (2 if table.model[k] == "EXP" else 0):
            remedy = "give that of p and that of q" if table.model[k] == "EXP" else "leave it empty for this model"
            raise _refuse(network, f"load {one}", "exponents", exponents, remedy)
        check_numbers(network.name, "load", [one] * len(exponents), {"exponents": exponents})
        if table.model[k] != "ZIP":
            if shares:
                raise _refuse(network, f"load {one}", "zip", shares, f"leave it empty for the model {table.model[k]}")
            continue
        if len(shares) != 6:
            raise _refuse(network, f"load {one}", "zip", shares, "give shares of Z, I, P in p, then in q")
        check_numbers(network.name, "load", [one] * 6, {"zip": shares})
        if max(abs(sum(shares[:3]) - 1.0), abs(sum(shares[3:]) - 1.0)) > 1e-9:
            raise _refuse(network, f"load {one}", "zip", shares, "the shares of p and those of q must add up to 1")


def _check_capacitors(network: Network, buses: dict[str, tuple[str, float]]) -> None:
    _numbers(network, "capacitor", ["leg_kv"], positive=True)
    _check_legs(network, "capacitor", ["kvar"], buses)
    for one, is_fixed in zip(network.capacitor.name, network.capacitor.is_fixed, strict=False):
        if is_fixed not in (0, 1):
            remedy = "give 1 if it stays in its state, or 0"
            raise _refuse(network, f"capacitor {one}", "is_fixed", is_fixed, remedy)


def _check_capacitor_controls(network: Network, buses: dict[str, tuple[str, float]]) -> None:
    table, banks, controlled = network.capacitor_control, network.capacitor.name, set()
    _numbers(network, "capacitor_control", ["on_at", "off_at"])
    _numbers(network, "capacitor_control", ["pt_ratio", "ct_ratio"], positive=True)
    _numbers(network, "capacitor_control", ["delay_on_s", "delay_off_s", "dead_time_s"], non_negative=True)
    for field in ("low_v", "high_v", "least_kvar"):
        if getattr(table, field):
            _numbers(network, "capacitor_control", [field], may_be_nan=True)
    for k, one in enumerate(table.name):
        subject, bank = f"capacitor control {one}", table.capacitor[k]
        low = table.measures[k] in ("voltage", "power_factor")
        if bank not in banks or bank in controlled:
            remedy = "it has a control already" if bank in banks else f"there are {', '.join(banks) or 'none'}"
            raise _refuse(network, subject, "capacitor", bank, remedy)
        controlled.add(bank)
        after = table.after[k] if table.after else ""
        if after and (after not in banks or after == bank):
            raise _refuse(network, subject, "after", after, f"give another of {', '.join(banks)}, or leave it empty")
        if not (table.on_at[k] < table.off_at[k] if low else table.on_at[k] > table.off_at[k]):
            remedy = f"for {table.measures[k]} it must be {'less' if low else 'more'} than off_at, {table.off_at[k]:g}"
            raise _refuse(network, subject, "on_at", table.on_at[k], remedy)
        legs = table.legs[k].split() if isinstance(table.legs[k], str) else []
        there = buses.get(table.bus[k], ("", 1.0))[0]
        if not legs or any(len(set(leg)) not in (1, 2) or not set(leg) <= set(there) for leg in legs):
            remedy = f"give phases or pairs of phases of bus {table.bus[k]}, which has {there or 'none'}"
            raise _refuse(network, subject, "legs", table.legs[k], remedy)
        for field in ("from_bus", "to_bus") if table.measures[k] != "voltage" else ():
            bus = getattr(table, field)[k]
            if bus not in buses or not set(table.phases[k]) <= set(buses[bus][0]):
                raise _refuse(network, subject, field, bus, f"give a bus with the phases {table.phases[k]}")


def _check_cores(network: Network, buses: dict[str, tuple[str, float]]) -> None:
    _numbers(network, "core", ["leg_kv"], positive=True)
    _check_legs(network, "core", ["p_kw", "q_kvar"], buses)


def node_names(nodes: str) -> list[tuple[str, str]]:
    """Bus and letter of each node in a text such as ``"650.a 650.b"``; an empty letter where there is none.

    The name of a bus may contain blanks.
    """
    pairs, text = [], ""
    for word in re.split(r"(\s+)", nodes.strip()):
        text += word
        bus, dot, letter = text.rpartition(".") if word[-2:-1] == "." else ("", "", "")
        if dot and letter in LETTERS:
            pairs.append((bus.lstrip(), letter))
            text = ""
    return [*pairs, *((word, "") for word in text.split())]


def _check_admittances(network: Network, buses: dict[str, tuple[str, float]]) -> None:
    table = network.admittance
    for k, one in enumerate(table.name):
        subject = f"admittance {one}"
        for field in ("kind", "nodes"):
            if not isinstance(getattr(table, field)[k], str) or not getattr(table, field)[k]:
                raise _refuse(network, subject, field, getattr(table, field)[k], "give a text")
        nodes = node_names(table.nodes[k])
        for bus, letter in nodes:
            if bus not in buses or not letter or letter not in buses[bus][0]:
                raise _refuse(network, subject, "nodes", f"{bus}.{letter}", "no such node; give bus.phase of the nodes")
        if len(set(nodes)) < len(nodes):
            raise _refuse(network, subject, "nodes", table.nodes[k], "give each node once")
        size = len(nodes) * (len(nodes) + 1) // 2
        for field in ("g_s", "b_s"):
            values = getattr(table, field)[k]
            if not isinstance(values, tuple) or len(values) != size:
                remedy = f"give the upper triangle of the matrix of its {len(nodes)} nodes, {size} figures"
                raise _refuse(network, subject, field, values, remedy)
            check_numbers(network.name, "admittance", [one] * size, {field: values})
