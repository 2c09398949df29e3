"""Checks of a grid's tables: each refusal names the feeder, the component, the field and its value."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

from dcgrid_env.core.magnitudes import wrong_magnitude
from dcgrid_env.grid.network import LineTable, Network
from dcgrid_env.grid.seasonal_ratings import check_ratings
from dcgrid_env.grid.topology import FeederError


def check_lengths(name: str, component: str, n: int, fields: Mapping[str, Sequence[Any] | None]) -> None:
    """Raise FeederError at the first field (None is left out) that has not one value for each of ``n`` rows."""
    for field, values in fields.items():
        if values is not None and len(values) != n:
            raise FeederError(f"feeder {name!r}: {len(values)} values of {field} for {n} {component} rows")


def check_numbers(
    name: str,
    component: str,
    ids: Sequence[Any],
    fields: Mapping[str, Sequence[float]],
    *,
    non_negative: bool = False,
    positive: bool = False,
    may_be_nan: bool = False,
) -> None:
    """Raise FeederError, naming component and field, at the first value that is not finite or of the wrong sign."""
    check_lengths(name, component, len(ids), fields)
    for field, values in fields.items():
        for i, value in zip(ids, values, strict=True):
            if isinstance(value, bool) or not isinstance(value, Real) or (math.isnan(value) and not may_be_nan):
                raise FeederError(f"feeder {name!r}: {component} {i}: {field} is {value!r}; give a finite number")
            if math.isinf(value):
                raise FeederError(f"feeder {name!r}: {component} {i}: {field} is {value!r}; give a finite number")
            quantity = str(i).split()[0] if field == "value" else field
            if wrong := wrong_magnitude(quantity, value):
                raise FeederError(f"feeder {name!r}: {component} {i}: {field} is {value}; {wrong}")
            if (non_negative and value < 0) or (positive and value <= 0):
                wanted = "> 0" if positive else ">= 0"
                raise FeederError(f"feeder {name!r}: {component} {i}: {field} is {value}; it must be {wanted}")


def check_balanced(network: Network) -> None:
    """Raise FeederError unless the tables describe a balanced grid: one source, one node a bus, usable figures.

    The connections are not checked: see ``topology.orient`` and ``check_loop_impedance``.
    """
    name, source, node, line = network.name, network.source, network.node, network.line
    for kind in ("phase_line", "switch", "transformer", "regulator", "phase_load", "capacitor"):
        table = getattr(network, kind)
        if len(table):
            raise FeederError(
                f"feeder {name!r}: {kind.replace('_', ' ')} {table.name[0]} cannot be used; balanced feeders take "
                "lines, shunts, loads, a source: make a ThreePhaseFeeder of these tables"
            )
    if len(source) != 1:
        raise FeederError(f"feeder {name!r}: {len(source)} sources; give one, at the substation")
    buses = set(node.bus)
    for kind, table in (("node", node), ("load", network.load), ("shunt", network.shunt)):
        for bus, phase in zip(table.bus, table.phase, strict=True):
            if phase != 0:
                raise FeederError(
                    f"feeder {name!r}: {kind} at bus {bus!r} is of phase {phase!r}; balanced feeders have phase 0 alone"
                )
            if bus not in buses:
                raise FeederError(f"feeder {name!r}: {kind} at the unknown bus {bus!r}; add it to the nodes")
    voltages = [source.base_kv[0], source.v_pu[0]]
    check_numbers(name, "feeder", ["base_kv", "v0_pu"], {"value": voltages}, positive=True)
    check_numbers(name, "bus", network.load.bus, {"p_kw": network.load.p_kw, "q_kvar": network.load.q_kvar})
    shunt = network.shunt
    figures = {field: getattr(shunt, field) for field in ("capacitor_kvar", "shunt_kw", "shunt_kvar")}
    check_numbers(name, "bus", shunt.bus, {field: values for field, values in figures.items() if values})
    branches = [f"{i}-{j}" for i, j in zip(line.from_bus, line.to_bus, strict=True)]
    check_numbers(name, "branch", branches, {"r_ohm": line.r_ohm, "x_ohm": line.x_ohm}, non_negative=True)
    if line.rating_a:
        check_numbers(name, "branch", branches, {"rating_a": line.rating_a}, positive=True, may_be_nan=True)
    check_numbers(name, "bus", node.bus, {"x": node.x, "y": node.y}, may_be_nan=True)
    figures = {field: getattr(node, field) for field in ("base_kv", "voltage_ratio")}
    figures = {field: values for field, values in figures.items() if values}
    check_numbers(name, "bus", node.bus, figures, positive=True, may_be_nan=True)
    for field, expected in (("base_kv", source.base_kv[0]), ("voltage_ratio", 1.0)):
        at_source = dict(zip(node.bus, figures.get(field, ()), strict=False)).get(source.bus[0], math.nan)
        if not math.isnan(at_source) and at_source != expected:
            raise FeederError(
                f"feeder {name!r}: bus {source.bus[0]}: {field} is {at_source}, but it is the substation, to whose "
                f"voltage all others are referred; give {expected:g} there"
            )
    check_ratings(network)


def check_loop_impedance(name: str, line: LineTable) -> None:
    """Raise FeederError for a loop of branches without impedance, in which any current could circulate."""
    joined: dict[str, str] = {}

    def one_of(bus: str) -> str:
        while joined.setdefault(bus, bus) != bus:
            bus = joined[bus]
        return bus

    for i, j, r_ohm, x_ohm in zip(line.from_bus, line.to_bus, line.r_ohm, line.x_ohm, strict=True):
        if r_ohm == 0 and x_ohm == 0:
            if one_of(i) == one_of(j):
                raise FeederError(
                    f"feeder {name!r}: branch {i}-{j}: r_ohm and x_ohm are 0, and it closes a loop of such branches, "
                    "whose currents are undefined; leave it out"
                )
            joined[one_of(i)] = one_of(j)
