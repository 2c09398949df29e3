"""From buses and branches to the tables of a feeder, referred to the substation's base voltage.

Buses that a closed switch joins become one bus, parallel branches become one branch, and admittances to ground move to
the buses. Elements that no source feeds are left out.

Ideal transformers are represented exactly. Let t be the voltage of a bus referred to the source divided by the bus
voltage, both per unit. Then t grows by ``tap`` across a transformer. Seen from the source, an impedance of the bus is
multiplied by t^2, a current by 1 / t, and an admittance of the bus by 1 / t^2.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dcgrid_env.apps.importers.bus_branch.description import Branch, BusBranchGrid, FloatArray, Source
from dcgrid_env.apps.importers.bus_branch.parallel_branches import Joint, joints
from dcgrid_env.apps.importers.bus_branch.supplied import Supplied, supplied_by
from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.grid.network import LineTable, Network, NodeTable, balanced_network
from dcgrid_env.grid.topology import FeederError

_LARGEST_PU, _LARGEST_RATIO = 1e15, 1e3
"""Beyond these a branch's figures are mistakes, and their squares might overflow."""


@dataclass(frozen=True)
class Reduced:
    """A balanced network, radial or with a few loops, and where each bus of the grid is in it."""

    network: Network
    bus_of: dict[str, str]
    """Bus of the network for each bus of the grid that a source feeds."""


def reduced_network(
    grid: BusBranchGrid,
    report: Report,
    *,
    source: str | None = None,
    allow: Collection[str] = (),
    source_of_facts: str = "",
) -> Reduced:
    """Reduce a grid to the tables of a balanced feeder, radial or with up to ``MOST_LOOPS`` loops.

    Parameters
    ----------
    grid
        Its buses and branches.
    report
        Takes what becomes of each element.
    source
        Name or bus of the source whose island is taken; needed where there are several.
    allow
        Kinds of elements that may be lost.
    source_of_facts
        Where the figures come from.

    Raises
    ------
    FeederError
        For too many loops, loops with a ratio or phase shift around them, several sources, branches of negative
        impedance and unlike transformers in parallel, naming them; for what is lost and not allowed.
    """
    _check_branches(grid, report)
    first = _one_bus_for_each_closed_switch(grid, report)
    shunts = _shunts(grid, first, report)
    alive = [
        replace(b, from_bus=int(first[b.from_bus]), to_bus=int(first[b.to_bus]))
        for b in grid.branches
        if b.from_closed and b.to_closed and first[b.from_bus] != first[b.to_bus]
    ]
    all_joints = joints(alive, report)
    root = _chosen(grid, source, first, all_joints, report.subject)
    supplied = supplied_by(int(first[root.bus]), grid.n_bus, all_joints, report)
    _report_sources(grid, root, first, supplied, report)
    _report_branches(grid, supplied, report)
    _report_unsupplied(grid, first, supplied, report)
    report.refuse_unless(grid.name, allow)
    network = _tables(grid, root, first, supplied, shunts)
    bus_of = {bus: grid.buses[i] for bus, i in zip(grid.buses, first.tolist(), strict=True) if i in supplied.ratios}
    return Reduced(replace(network, source_of_facts=source_of_facts), bus_of)


def _check_branches(grid: BusBranchGrid, report: Report) -> None:
    """FeederError for branches whose figures no power flow could use, or that would overflow here."""
    for b in grid.branches:
        figures = {"series impedance": b.z_pu, "admittance to ground": b.y_from_pu + b.y_to_pu}
        for figure, value in figures.items():
            if not abs(value) < _LARGEST_PU:
                report.add("refused", b.kind, b.name, f"its {figure} is {value:.3g} p.u.: give a finite figure")
        if not 1.0 / _LARGEST_RATIO < b.tap < _LARGEST_RATIO:
            report.add(
                "refused", b.kind, b.name, f"its ratio is {b.tap:.3g} p.u.: give one near 1, or right base voltages"
            )
    refused = [row for row in report.findings if row.fate == "refused"]
    if refused:
        report.refuse_unless(grid.name, ())


def _one_bus_for_each_closed_switch(grid: BusBranchGrid, report: Report) -> np.ndarray:
    """Row of the first bus of those that closed switches join with each bus, shape (n_bus,)."""
    first = list(range(grid.n_bus))

    def root(i: int) -> int:
        while first[i] != i:
            first[i] = first[first[i]]
            i = first[i]
        return i

    for switch in grid.switches:
        i, j = sorted((root(switch.from_bus), root(switch.to_bus)))
        first[j] = i
        if not math.isclose(grid.base_kv[i], grid.base_kv[j], rel_tol=1e-12):
            text = f"it joins buses of {grid.base_kv[i]:g} and {grid.base_kv[j]:g} kV: give both one base voltage"
            report.add("refused", "switch", switch.name, text)
    report.add_all("taken", "switch", [s.name for s in grid.switches], "closed: its two buses are one")
    return np.array([root(i) for i in range(grid.n_bus)], dtype=np.intp)


def _shunts(grid: BusBranchGrid, first: np.ndarray, report: Report) -> np.ndarray:
    """Return the complex admittance to ground of each bus including its branches, p.u. of its base, shape (n_bus,)."""
    total = (grid.shunt_kw + 1j * grid.shunt_kvar) / (1000.0 * grid.base_mva)
    for b in grid.branches:
        if b.from_closed and b.to_closed:
            total[b.from_bus] += b.y_from_pu / b.tap**2
            total[b.to_bus] += b.y_to_pu
            if first[b.from_bus] == first[b.to_bus]:
                if abs(b.tap - 1.0) > 1e-12:
                    report.add(
                        "refused", b.kind, b.name, "both its ends are at one bus, with a ratio: a current circulates"
                    )
                else:
                    report.add("nothing lost", b.kind, b.name, "both its ends are at one bus: it carries no current")
        elif b.from_closed:
            total[b.from_bus] += (b.y_from_pu + _behind(b.z_pu, b.y_to_pu)) / b.tap**2
            report.add("taken", b.kind, b.name, "open at one end: what it draws to ground there is a shunt")
        elif b.to_closed:
            total[b.to_bus] += b.y_to_pu + _behind(b.z_pu, b.y_from_pu)
            report.add("taken", b.kind, b.name, "open at one end: what it draws to ground there is a shunt")
        else:
            report.add("nothing lost", b.kind, b.name, "open or out of service: it is left out")
    return total


def _behind(z_pu: complex, y_pu: complex) -> complex:
    """Admittance of a series impedance with an admittance to ground at its far end."""
    return y_pu / (1.0 + z_pu * y_pu)


def _chosen(
    grid: BusBranchGrid, source: str | None, first: np.ndarray, all_joints: Sequence[Joint], subject: str
) -> Source:
    """The source whose island is taken; FeederError with all candidates if it is not clear which."""
    if not grid.sources:
        raise FeederError(f"grid {grid.name!r} has no source in service; add an external grid or a slack bus")
    named = [s for s in grid.sources if source in (s.name, grid.buses[s.bus])]
    if named:
        return named[0]
    islands = list(_islands(grid, first, all_joints))
    if source is None and len(islands) == 1:
        return islands[0][0]
    choices = " or ".join(
        f"--source {_words_for(grid, s)} ({len(fed_buses)} buses, {kw:.1f} kW of load)" for s, fed_buses, kw in islands
    )
    if source is None:
        raise FeederError(f"{subject} {grid.name!r} has sources of {len(islands)} islands; choose one by {choices}")
    raise FeederError(f"source: {source!r} is no source of {subject} {grid.name!r}; choose {choices}")


def _islands(
    grid: BusBranchGrid, first: np.ndarray, all_joints: Sequence[Joint]
) -> Iterator[tuple[Source, set[int], float]]:
    """Each island with a source: its first source, the buses that are fed, and their load in kW."""
    visited: set[int] = set()
    for source in grid.sources:
        start = int(first[source.bus])
        if start in visited:
            continue
        fed_buses = set(supplied_by(start, grid.n_bus, all_joints, Report()).ratios)
        visited |= fed_buses
        yield source, fed_buses, float(grid.p_kw[np.isin(first, list(fed_buses))].sum())


def _words_for(grid: BusBranchGrid, source: Source) -> str:
    """What to write after --source: its bus, or its name where the bus would choose another source."""
    bus = grid.buses[source.bus]
    hit = next(s for s in grid.sources if bus in (s.name, grid.buses[s.bus]))
    return shlex.quote(bus if hit is source else source.name)


def _report_sources(grid: BusBranchGrid, root: Source, first: np.ndarray, supplied: Supplied, report: Report) -> None:
    report.add("taken", root.kind, root.name, f"the substation, bus {grid.buses[first[root.bus]]}")
    for other in grid.sources:
        if other is root:
            continue
        if first[other.bus] == first[root.bus] and other.v_pu == root.v_pu:
            report.add("taken", other.kind, other.name, f"at the bus of {root.kind} {root.name}: one source")
        elif first[other.bus] in supplied.ratios:
            text = (
                f"it feeds the same island as {root.kind} {root.name}: a feeder has one source; open a switch between"
            )
            report.add("refused", other.kind, other.name, text)
        else:
            report.add("nothing lost", other.kind, other.name, "it feeds an island of its own, which is left out")


def _report_branches(grid: BusBranchGrid, supplied: Supplied, report: Report) -> None:
    for position, joint in enumerate(supplied.joints):
        for b in joint.members[:1]:
            texts = ["one branch"]
            if b.tap != 1.0 or grid.base_kv[b.from_bus] != grid.base_kv[b.to_bus]:
                texts = ["one branch, referred to the source by its turns ratio"]
            if b.shift_deg:
                texts.append("its phase shift turns all beyond it alike and is left out")
            if position in supplied.loops:
                texts.append(f"it closes a loop with {supplied.loops[position]}, which is solved by compensation")
            report.add("taken", b.kind, b.name, "; ".join(texts))
        z = joint.branch.z_pu
        if z.real < 0 or z.imag < 0:
            part = "resistance" if z.real < 0 else "reactance"
            size = z.real if z.real < 0 else z.imag
            b = joint.members[0]
            report.add("refused", b.kind, b.name, f"its series {part} is negative ({size:.3g} p.u.)")
    for joint in supplied.unsupplied:
        for b in joint.members:
            report.add("nothing lost", b.kind, b.name, "without supply: it is left out")


def _report_unsupplied(grid: BusBranchGrid, first: np.ndarray, supplied: Supplied, report: Report) -> None:
    for i, bus in enumerate(grid.buses):
        if int(first[i]) not in supplied.ratios:
            loaded = grid.p_kw[i] or grid.q_kvar[i] or grid.shunt_kw[i] or grid.shunt_kvar[i]
            text = (
                "without supply: it is left out with what stands there" if loaded else "without supply: it is left out"
            )
            report.add("nothing lost", "bus", bus, text)


def _tables(grid: BusBranchGrid, root: Source, first: np.ndarray, supplied: Supplied, shunts: np.ndarray) -> Network:
    """Return the tables of the supplied part, with the source bus first and the others in the grid's order."""
    source_bus = int(first[root.bus])
    rows = [source_bus, *(i for i in sorted(supplied.ratios) if i != source_bus)]
    base_kv = float(grid.base_kv[source_bus])
    z_base_ohm, i_base_a = base_kv**2 / grid.base_mva, 1000.0 * grid.base_mva / (math.sqrt(3.0) * base_kv)
    referred = np.array([supplied.ratios[i] for i in rows])

    def summed(values: FloatArray) -> FloatArray:
        total = np.zeros(grid.n_bus, dtype=values.dtype)
        np.add.at(total, first, values)
        return total[rows]

    shunt_kva = summed(shunts) * (1000.0 * grid.base_mva) / referred**2
    bus_base_kv, own_ratio = grid.base_kv[rows], 1.0 / referred
    branches = [_referred(joint, supplied) for joint in supplied.joints]
    rating_a = [b.rating_pu * i_base_a for b in branches]
    return balanced_network(
        grid.name,
        base_kv=base_kv,
        substation=grid.buses[source_bus],
        v0_pu=root.v_pu,
        nodes=NodeTable(
            tuple(grid.buses[i] for i in rows),
            (0,) * len(rows),
            tuple(grid.x[rows].tolist()),
            tuple(grid.y[rows].tolist()),
            base_kv=() if np.all(bus_base_kv == base_kv) else tuple(bus_base_kv.tolist()),
            voltage_ratio=() if np.all(own_ratio == 1.0) else tuple(own_ratio.tolist()),
        ),
        p_kw=tuple(summed(grid.p_kw).tolist()),
        q_kvar=tuple(summed(grid.q_kvar).tolist()),
        capacitor_kvar=(0.0,) * len(rows),
        lines=LineTable(
            tuple(grid.buses[b.from_bus] for b in branches),
            tuple(grid.buses[b.to_bus] for b in branches),
            tuple(b.z_pu.real * z_base_ohm for b in branches),
            tuple(b.z_pu.imag * z_base_ohm for b in branches),
            () if np.all(np.isnan(rating_a)) else tuple(rating_a),
        ),
        shunt_kw=tuple(shunt_kva.real.tolist()) if np.any(shunt_kva.real) else None,
        shunt_kvar=tuple(shunt_kva.imag.tolist()) if np.any(shunt_kva.imag) else None,
    )


def _referred(joint: Joint, supplied: Supplied) -> Branch:
    """A branch away from the source, its impedance and rating referred to the source's base voltage."""
    b, t = joint.branch, supplied.ratios[joint.branch.to_bus]
    return replace(b, z_pu=b.z_pu * t**2, rating_pu=b.rating_pu / t)
