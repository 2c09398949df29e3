"""Data of a three-phase feeder in the layout of the compiled sweeps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.grid.three_phase_legs import Legs
from dcgrid_env.grid.three_phase_matrices import PHASE_BASE_KVA

LINE, REGULATOR, TRANSFORMER = 0, 1, 2


class Plan(NamedTuple):
    """Arrays of a feeder, with unsigned indices, so that the compiled code need not check for negative ones.

    Four nodes are added to the feeder's: node ``n_node`` is ground, whose voltage is 0, and the next three are those of
    the ideal source.
    """

    first: np.ndarray
    """First node of each bus, and n_node at the end, (n_bus + 1,). This and the figures up to ``shunt`` are empty
    for feeders that are not radial, apart from the length of ``up``."""
    up: np.ndarray
    """Node that feeds each node, (n_node,)."""
    kind: np.ndarray
    """Kind of the branch that feeds each bus, (n_bus,): a line, a regulator or a transformer."""
    a: np.ndarray
    """Voltage ratios of the branches, (n_bus, 9), a matrix row by row; of a regulator at neutral."""
    z_re: np.ndarray
    """Series resistance, p.u., (n_bus, 9)."""
    z_im: np.ndarray
    """Series reactance, p.u., (n_bus, 9)."""
    regulator: np.ndarray
    """Row of each node's regulator, (n_node,); 0 where there is none, which nothing reads."""
    shunt: np.ndarray
    """Susceptance to ground, p.u., (n_bus, 9)."""
    leg_order: np.ndarray
    """The loads' legs in the order of their buses, (n_load_leg,)."""
    leg_start: np.ndarray
    """First leg of each bus in that order, and their number at the end, (n_bus + 1,)."""
    leg_ends: np.ndarray
    """Node and other node of each leg, in that order, (n_load_leg, 2)."""
    leg_is_z: np.ndarray
    """Whether the leg is a constant impedance, bool, (n_load_leg,)."""
    leg_has_exponents: np.ndarray
    """Whether the leg has exponents, bool, (n_load_leg,)."""
    leg_law: np.ndarray
    """Rows of ``LAW`` for each leg, (n_load_leg, len(LAW))."""
    capacitor_ends: np.ndarray
    """Node and other node of each capacitor's leg, (n_capacitor_leg, 2)."""
    capacitor_row: np.ndarray
    """Bank of each capacitor's leg, (n_capacitor_leg,)."""
    capacitor_b: np.ndarray
    """Susceptance of each capacitor's leg, p.u., (n_capacitor_leg,)."""
    core_ends: np.ndarray
    """Node and other node of each leg of a transformer's core, (n_core_leg, 2)."""
    core_g: np.ndarray
    """Conductance of each leg of a core, p.u., (n_core_leg,)."""
    core_b: np.ndarray
    """Susceptance of each leg of a core, p.u., (n_core_leg,)."""
    source: np.ndarray
    """Voltages of the ideal source at 1 p.u., real and imaginary, (3, 2)."""
    has_voltage: np.ndarray
    """Whether a voltage near 0 is refused, bool, (n_node,): at all nodes of radial feeders, or where legs draw."""
    ampere: np.ndarray
    """Base current of each node, A, (n_node,)."""


LAW = (
    "scale",
    "rated_sq",
    "z_p",
    "i_p",
    "c_p",
    "z_q",
    "i_q",
    "c_q",
    "inverse_vmax",
    "inverse_vmin",
    "inverse_vlow",
    "slope_p",
    "offset_p",
    "slope_q",
    "offset_q",
    "power_p",
    "power_q",
)
"""Columns of ``Plan.leg_law``: p.u. a kW and squared p.u. voltage; squared rated voltage over base; the shares of the
law; the limits; and the line below vmin, h = slope + offset / u. The last two are the powers of 1 / u of a leg with
exponents."""


@cached_on_owner
def plan_of(feeder: ThreePhaseFeeder) -> Plan:
    """Lay a feeder out for the compiled sweeps, once."""
    n_node, n_bus, legs = feeder.n_node, feeder.n_bus, feeder.load_legs
    order = np.argsort(legs.bus, kind="stable")
    start = np.searchsorted(legs.bus[order], np.arange(n_bus + 1))
    capacitors, cores = feeder.capacitor_legs, feeder.core_legs
    angle = np.deg2rad(feeder.source_angle_deg)
    ratio = feeder.network.source.base_kv[0] / np.sqrt(3.0) / feeder.base_kv_ln[0]
    return Plan(
        **(_of_branches(feeder) if feeder.is_radial else _without_branches(n_node)),
        leg_order=_index(order),
        leg_start=_index(start),
        leg_ends=_ends(legs, order, n_node),
        leg_is_z=(legs.share[0, order] == 1.0) & (legs.share[3, order] == 1.0),
        leg_has_exponents=~np.isnan(legs.exponent[0, order]),
        leg_law=_law(legs, order),
        capacitor_ends=_ends(capacitors, np.arange(len(capacitors.row)), n_node),
        capacitor_row=_index(capacitors.row),
        capacitor_b=-capacitors.q_kvar / PHASE_BASE_KVA / capacitors.rated_pu**2,
        core_ends=_ends(cores, np.arange(len(cores.row)), n_node),
        core_g=cores.p_kw / PHASE_BASE_KVA / cores.rated_pu**2,
        core_b=-cores.q_kvar / PHASE_BASE_KVA / cores.rated_pu**2,
        source=ratio * np.stack((np.cos(angle), np.sin(angle)), axis=1),
        has_voltage=_has_voltage(feeder),
        ampere=PHASE_BASE_KVA / feeder.base_kv_ln[feeder.node_bus],
    )


def _has_voltage(feeder: ThreePhaseFeeder) -> np.ndarray:
    has_voltage = np.full(feeder.n_node, feeder.is_radial)
    has_voltage[feeder.load_legs.node[feeder.load_legs.other < 0]] = True
    return has_voltage


def _of_branches(feeder: ThreePhaseFeeder) -> dict[str, np.ndarray]:
    branches, n_bus = feeder.branches, feeder.n_bus
    up = feeder.node_parent.copy()
    up[:3] = feeder.n_node + 1 + np.arange(3)
    kind = np.full(n_bus, LINE)
    size = np.diff(feeder.first_node)
    for i in range(1, n_bus):
        same = np.array_equal(branches.a[i, : size[i], : size[i]], np.eye(size[i]))
        kind[i] = REGULATOR if (branches.regulator[i] >= 0).any() else LINE if same else TRANSFORMER
    of_node = [branches.regulator[i, k] for i in range(n_bus) for k in range(size[i])]
    return {
        "first": _index(feeder.first_node), "up": _index(up), "kind": _index(kind),
        "a": branches.a.reshape(n_bus, 9).copy(), "z_re": branches.b.real.reshape(n_bus, 9).copy(),
        "z_im": branches.b.imag.reshape(n_bus, 9).copy(), "regulator": _index(np.maximum(of_node, 0)),
        "shunt": branches.shunt.reshape(n_bus, 9).copy(),
    }  # fmt: skip


def _without_branches(n_node: int) -> dict[str, np.ndarray]:
    """No branches: the nodal equations have them. Only the number of nodes is read."""
    nothing, nodes = np.zeros((0, 9)), _index(np.zeros(n_node))
    empty = _index(np.zeros(0))
    matrices = dict.fromkeys(("a", "z_re", "z_im", "shunt"), nothing)
    return {"first": empty, "up": nodes, "kind": empty, "regulator": nodes, **matrices}


def _index(values: Array) -> np.ndarray:
    return np.array(values, np.uint64)


def _ends(legs: Legs, order: np.ndarray, ground: int) -> np.ndarray:
    other = np.where(legs.other < 0, ground, legs.other)
    return _index(np.stack((legs.node, other), axis=1)[order])


def _law(legs: Legs, order: np.ndarray) -> np.ndarray:
    share, (vlow, vmin, vmax) = legs.share, legs.limit_pu
    rated_sq = legs.rated_pu**2
    rows = [1.0 / (PHASE_BASE_KVA * rated_sq), rated_sq, *share, 1.0 / vmax, 1.0 / vmin, 1.0 / vlow]
    for z, i, c in (share[:3], share[3:]):
        h_vmin = z + i / vmin + c / vmin**2
        slope = (h_vmin * vmin - vlow) / (vmin - vlow)
        rows += [slope, (1.0 - slope) * vlow]
    rows += list(np.nan_to_num(2.0 - legs.exponent))
    return np.ascontiguousarray(np.array(rows).reshape(len(LAW), -1).T[order])
