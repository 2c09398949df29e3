"""The generalised matrices of every branch of a three-phase feeder, and the susceptances at its buses, per unit.

The equations follow W. H. Kersting, "Distribution System Modeling and Analysis", chapters 6 to 8. From the sending bus
n to the receiving bus m they are V_m = A V_n - B I_m and I_n = d I_m, for line-to-ground voltages and line currents.
Half of a line's charging is modelled at each of its two buses, so a third matrix is not needed. The branches are
reciprocal: d = A^T.

Per unit is on the line-to-neutral base voltage of each bus and one base power a phase, ``PHASE_BASE_KVA``.
docs/decisions/0010-three-phase.md has the derivation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.grid.network import Network
from dcgrid_env.grid.per_unit import S_BASE_KVA
from dcgrid_env.grid.three_phase_tables import TransformerTable
from dcgrid_env.grid.three_phase_tree import Branch, Tree

PHASE_BASE_KVA = S_BASE_KVA
"""Base power of a phase, kVA."""
_PER_SIEMENS = 1000.0 / PHASE_BASE_KVA  # times the squared base voltage in kV
_ALL = np.eye(3)
_ZERO_SEQUENCE_FREE = np.eye(3) - np.ones((3, 3)) / 3.0


class Branches(NamedTuple):
    """Matrices over buses in depth-first order; those of bus 0 are the source's, whose impedance feeds it.

    The first rows and columns are the phases of the fed bus, in order. The remaining entries are 0.
    """

    a: NDArray[np.float64]
    """Shape (n_bus, 3, 3); of a regulator at its neutral tap."""
    b: NDArray[np.complex128]
    """Shape (n_bus, 3, 3); of a regulator at its neutral tap."""
    regulator: NDArray[np.intp]
    """Row of the regulators' table of each phase, -1 for none, shape (n_bus, 3)."""
    shunt: NDArray[np.float64]
    """Susceptance to ground of lines and terminals at each bus, shape (n_bus, 3, 3)."""
    sending_shunt: NDArray[np.float64]
    """Part of it at the sending end of the branch to each bus, by the phases of that bus, shape (n_bus, 3, 3)."""


def branches_of(network: Network, tree: Tree, base_kv: NDArray[np.float64]) -> Branches:
    """Compile the branches of checked tables; ``base_kv`` is the base of each bus, line to neutral, shape (n_bus,)."""
    n = len(tree.bus_ids)
    a, b = np.zeros((n, 3, 3)), np.zeros((n, 3, 3), np.complex128)
    regulator, shunt = np.full((n, 3), -1, np.intp), np.zeros((n, 3, 3))
    sending_shunt = np.zeros((n, 3, 3))
    source = network.source
    a[0] = _ALL
    b[0] = (np.array(source.r_ohm[0]) + 1j * np.array(source.x_ohm[0])) / _base_ohm(base_kv[0])
    for i in range(1, n):
        branch, sender = tree.branches[i - 1], int(tree.parent[i - 1])
        bases = (base_kv[sender], base_kv[i])
        size = len(branch.phases)
        ratio, z_ohm, shunts, tapped = _KINDS[branch.kind](network, branch, bases)
        a[i, :size, :size], b[i, :size, :size] = ratio, z_ohm / _base_ohm(bases[1])
        regulator[i, :size] = tapped
        for bus, siemens in zip((sender, i), shunts, strict=True):
            positions = [tree.phases[bus].index(phase) for phase in branch.phases]
            shunt[bus][np.ix_(positions, positions)] += siemens * base_kv[bus] ** 2 * _PER_SIEMENS
        sending_shunt[i, :size, :size] = shunts[0] * base_kv[sender] ** 2 * _PER_SIEMENS
    return Branches(a, b, regulator, shunt, sending_shunt)


def _base_ohm(base_kv: float) -> float:
    return base_kv**2 * 1000.0 / PHASE_BASE_KVA


def _line(network: Network, branch: Branch, bases: tuple[float, float]) -> tuple:
    row, table, positions = branch.rows[0], network.phase_line, ["abc".index(phase) for phase in branch.phases]
    r, x, b_us = (np.array(m[row], float)[np.ix_(positions, positions)] for m in (table.r_ohm, table.x_ohm, table.b_us))
    half = 0.5e-6 * b_us
    return np.eye(len(positions)), r + 1j * x, (half, half), -1


def _switch(network: Network, branch: Branch, bases: tuple[float, float]) -> tuple:
    row, table, one = branch.rows[0], network.switch, np.eye(len(branch.phases))
    nothing = np.zeros_like(one)
    return one, (table.r_ohm[row] + 1j * table.x_ohm[row]) * one, (nothing, nothing), -1


def _transformer(network: Network, branch: Branch, bases: tuple[float, float]) -> tuple:
    """Return the matrices of a transformer by Kersting, chapter 8, with its impedance at the to-side.

    The to-side is a wye or the equivalent wye of a delta.
    """
    row, table, size = branch.rows[0], network.transformer, len(branch.phases)
    windings = (table.connection_from[row], table.connection_to[row])
    kv_ln = (table.kv_ll_from[row] / math.sqrt(3.0), table.kv_ll_to[row] / math.sqrt(3.0))
    z_ohm = transformer_impedance(table, row)
    scale = kv_ln[1] / kv_ln[0] * bases[0] / bases[1]
    turned = np.eye(size)
    through = np.eye(size)
    if windings == ("delta", "wye_grounded"):  # the winding of phase a stands between a and c, or between a and b
        turned = (_ALL - np.roll(_ALL, -1 if table.shift_deg[row] < 0 else 1, axis=1)) / math.sqrt(3.0)
    elif windings == ("delta", "delta"):  # line-to-line voltages alone go through; the zero sequence is set to zero
        turned = through = _ZERO_SEQUENCE_FREE
    return scale * turned, z_ohm * through, winding_shunts(table, row), -1


def symmetric(g: Sequence[float], b: Sequence[float]) -> NDArray[np.complex128]:
    """The symmetric matrix G + jB from the upper triangles of both, row by row."""
    size = (math.isqrt(8 * len(g) + 1) - 1) // 2
    upper = np.zeros((size, size), np.complex128)
    upper[np.triu_indices(size)] = np.array(g) + 1j * np.array(b)
    return upper + np.triu(upper, 1).T


def transformer_impedance(table: TransformerTable, row: int) -> complex:
    """Impedance of a phase at the to-side, ohm."""
    kva, kv_ln = table.kva[row] / len(table.phases[row]), table.kv_ll_to[row] / math.sqrt(3.0)
    return complex(table.r_percent[row], table.x_percent[row]) / 100.0 * kv_ln**2 * 1000.0 / kva


def winding_shunts(table: TransformerTable, row: int) -> tuple[NDArray[np.float64], ...]:
    """Susceptance to ground of a transformer's phases, from-side and to-side, S."""
    size, windings = len(table.phases[row]), (table.connection_from[row], table.connection_to[row])
    kva, kv_ln = table.kva[row] / size, (table.kv_ll_from[row] / math.sqrt(3.0), table.kv_ll_to[row] / math.sqrt(3.0))
    return tuple(
        -1e-9 * table.antifloat_ppm[row] * kva / v**2 * (0.5 if winding != "delta" else 1.0 / 3.0) * np.eye(size)
        for winding, v in zip(windings, kv_ln, strict=True)
    )


def _regulator(network: Network, branch: Branch, bases: tuple[float, float]) -> tuple:
    size, table = len(branch.phases), network.regulator
    z_ohm, shunt = np.zeros((size, size), np.complex128), np.zeros((size, size))
    tapped = np.zeros(size, np.intp)
    for row in branch.rows:
        for phase in table.phases[row]:
            i = branch.phases.index(phase)
            tapped[i] = row
            base_ohm = table.kv_ln[row] ** 2 * 1000.0 / table.kva_per_phase[row]
            z_ohm[i, i] = complex(table.r_percent[row], table.x_percent[row]) / 100.0 * base_ohm
            shunt[i, i] = -0.5e-6 * table.antifloat_ppm[row] / base_ohm
    return np.eye(size), z_ohm, (shunt, shunt), tapped


_KINDS = {"phase_line": _line, "switch": _switch, "transformer": _transformer, "regulator": _regulator}
