"""Sensitivity of the voltage at each node to the power at each node.

A balanced feeder is linearised around 1 p.u. without load. A three-phase feeder is linearised around its base loads,
taps and capacitors, because the base taps and the load models affect its sensitivities.

For a balanced feeder these are the matrices R and X of LinDistFlow: the sums of r and x over the path that two nodes
share to the substation (M. E. Baran, F. F. Wu, "Optimal capacitor placement on radial distribution systems", IEEE
Trans. Power Delivery 4(1), 1989). Transformers off their nominal ratio scale a change of voltage as they scale the
voltage. Shunts and losses are left out, because their effect on these figures is of second order.

With loops, currents divide by impedance. Let Z be the complex sums of r + jx of the tree. Column m of C is 1 at the
sending bus and -1 at the receiving bus of the branch that closes loop m, whose impedance is z_m. The matrices are then
the real and imaginary part of Z - Z C (C^T Z C + diag(z))^-1 C^T Z.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.grid import Feeder, ThreePhaseFeeder
from dcgrid_env.grid.per_unit import S_BASE_KVA
from dcgrid_env.powerflow.unbalanced.linearised import linearise

_PU_PER_MVA = 1000.0 / S_BASE_KVA


class Sensitivity(NamedTuple):
    """Derivatives of voltage magnitudes by power *injected*; a load of as much lowers the voltage by as much."""

    by_p_pu_per_mw: NDArray[np.float64]
    """dV_i / dp_j, p.u. per MW injected, row i, column j."""
    by_q_pu_per_mvar: NDArray[np.float64]
    """dV_i / dq_j, p.u. per Mvar injected, row i, column j."""


@cached_on_owner
def sensitivity(feeder: Feeder | ThreePhaseFeeder) -> Sensitivity:
    """Derivative of the voltage at every node by the power injected at every node.

    Returns
    -------
    Sensitivity
        Two read-only matrices of shape (n_node, n_node), made once for a feeder. Rows and columns of a balanced
        feeder's source are zero: its voltage is given. In a three-phase feeder power is injected from ground at the
        devices' leg of each node, entries go across phases and may be negative, and the source has an impedance.
    """
    if isinstance(feeder, ThreePhaseFeeder):
        slopes = linearise(feeder, feeder.p_load_kw, feeder.q_load_kvar)
        return Sensitivity(*map(_read_only, slopes[:2]))
    path, tree = feeder.path, slice(feeder.n_bus - 1)
    r, x = ((path * z_pu[tree]) @ path.T * _PU_PER_MVA for z_pu in (feeder.r_pu, feeder.x_pu))
    if feeder.loop_ends is not None:
        by_loop, divided = _by_loops(feeder)
        less = by_loop.T @ divided
        r, x = r - less.real, x - less.imag
    if feeder.voltage_ratio is not None:
        r, x = (feeder.voltage_ratio[:, None] * rise for rise in (r, x))
    return Sensitivity(_read_only(r), _read_only(x))


def sensitivity_by(feeder: Feeder, buses: Sequence[int]) -> Sensitivity:
    """Return the derivative of the voltage at every bus by the power injected at some buses, without whole matrices.

    Memory and time are linear in the number of buses. The shared path of two buses ends at their lowest common
    ancestor. A row is therefore a prefix sum in depth-first order: each branch of a path adds its impedance where its
    subtree begins and subtracts it where the subtree ends.

    Returns
    -------
    Sensitivity
        Columns of :func:`sensitivity` up to rounding, shape (len(buses), n_bus): row k is by the power at ``buses[k]``.
    """
    rows = _along_paths(feeder, buses)
    if feeder.loop_ends is not None:
        by_loop, divided = _by_loops(feeder)
        less = by_loop[:, list(buses)].T @ divided
        rows = [rows[0] - less.real, rows[1] - less.imag]
    if feeder.voltage_ratio is not None:
        rows = [feeder.voltage_ratio * row for row in rows]
    return Sensitivity(*rows)


def _along_paths(feeder: Feeder, buses: Sequence[int]) -> list[NDArray[np.float64]]:
    """Return the sums of r and of x over the path that each of some buses shares with every bus, in the tree."""
    index, rows = feeder.depth_first, []
    for z_pu in (feeder.r_pu, feeder.x_pu):
        change = np.zeros((len(buses), feeder.n_bus + 1))
        for row, bus in zip(change, buses, strict=True):
            path, place = [], int(index.place[bus])
            while place:
                path.append(place)
                place = int(index.parent[place])
            z = z_pu[index.order[path] - 1]
            np.add.at(row, path, z)
            np.subtract.at(row, index.end[path], z)
        rows.append(np.cumsum(change, axis=1)[:, index.place] * _PU_PER_MVA)
    return rows


@cached_on_owner
def _by_loops(feeder: Feeder) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return C^T Z and (C^T Z C + diag(z))^-1 C^T Z of a feeder with loops, both (n_loop, n_bus), in p.u. per MVA."""
    sending, receiving = feeder.from_bus[feeder.n_bus - 1 :], feeder.to_bus[feeder.n_bus - 1 :]
    both = np.concatenate((sending, receiving))
    r, x = _along_paths(feeder, both.tolist())
    from_both = r + 1j * x
    by_loop = from_both[: feeder.n_loop] - from_both[feeder.n_loop :]
    z = (feeder.r_pu + 1j * feeder.x_pu)[feeder.n_bus - 1 :] * _PU_PER_MVA
    around = by_loop[:, sending] - by_loop[:, receiving] + np.diag(z)
    return by_loop, np.linalg.solve(around, by_loop).astype(np.complex128)


@cached_on_owner
def own_sensitivity(feeder: Feeder | ThreePhaseFeeder) -> Sensitivity:
    """Derivative of the voltage at every node by the power injected at that same node.

    Returns
    -------
    Sensitivity
        The diagonals of :func:`sensitivity` up to rounding, read-only and of shape (n_node,); for a balanced feeder no
        matrix is made.
    """
    if isinstance(feeder, ThreePhaseFeeder):
        return Sensitivity(*(_read_only(np.diagonal(slope).copy()) for slope in sensitivity(feeder)))
    sensitivities = np.zeros((2, feeder.n_node))
    for j in feeder.depth_first.order[1:]:
        sensitivities[:, j] = sensitivities[:, feeder.parent[j - 1]] + (feeder.r_pu[j - 1], feeder.x_pu[j - 1])
    if feeder.loop_ends is not None:
        by_loop, divided = _by_loops(feeder)
        less = (by_loop * divided).sum(axis=0) / _PU_PER_MVA
        sensitivities -= (less.real, less.imag)
    if feeder.voltage_ratio is not None:
        sensitivities *= feeder.voltage_ratio
    return Sensitivity(*map(_read_only, sensitivities * _PU_PER_MVA))


def _read_only(array: NDArray[np.float64]) -> NDArray[np.float64]:
    array.flags.writeable = False
    return array
