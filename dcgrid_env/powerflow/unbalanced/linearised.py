"""A three-phase power flow linearised where it stands: how every voltage moves with every power.

Figures are signed and go across phases: a load on one phase lowers its own voltage and may raise another's.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.core.arrays import Array
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.powerflow.control import Control
from dcgrid_env.powerflow.solution import PowerFlowError
from dcgrid_env.powerflow.unbalanced.sweep import solve_unbalanced
from dcgrid_env.powerflow.unbalanced.three_phase_inputs import check_legs, control_inputs, source_voltage

_TOLERANCE_PU = 1e-12
_NODAL_TOLERANCE_PU = 1e-9
"""For nodal equations, whose rounding is coarser: 3e-11 p.u. on the IEEE 8500-node feeder."""
FloatArray = NDArray[np.float64]


class Linearised(NamedTuple):
    """Derivatives of voltage magnitudes, row i the voltage at node i; power is *injected* at the devices' legs."""

    by_p_pu_per_mw: FloatArray
    """dV_i / dp_j, p.u. per MW injected from ground at node j, shape (n_node, n_node)."""
    by_q_pu_per_mvar: FloatArray
    """dV_i / dq_j, p.u. per Mvar injected from ground at node j, shape (n_node, n_node)."""


def linearise(
    feeder: ThreePhaseFeeder,
    p_kw: Array,
    q_kvar: Array,
    source_voltage_pu: float | None = None,
    control: Control | None = None,
    nodes: Sequence[int] | None = None,
) -> Linearised:
    """Linearise one power flow, by the compiled derivative for the weight of each node.

    For a feeder that is not radial, it factors the nodal equations at the solution instead.

    Parameters
    ----------
    feeder, p_kw, q_kvar, source_voltage_pu, control
        One power flow as :func:`solve_unbalanced` takes it, powers of shape (n_leg,), NumPy arrays.
    nodes
        Nodes whose voltages are wanted, which are then the rows; all nodes for None. Time and memory go with their
        number.

    Raises
    ------
    PowerFlowError
        For what cannot be used, and for a power flow without a solution.
    """
    from dcgrid_env.powerflow.unbalanced.adjoint_batch import derivatives  # brings the compiler with it

    tolerance_pu = _TOLERANCE_PU if feeder.is_radial else _NODAL_TOLERANCE_PU
    solution = solve_unbalanced(feeder, p_kw, q_kvar, source_voltage_pu, control, tolerance_pu=tolerance_pu)
    p_kw, q_kvar = check_legs(feeder, p_kw, q_kvar)
    if p_kw.ndim != 1 or not solution.converged:
        raise PowerFlowError(
            f"feeder {feeder.name!r}: p_kw has shape {p_kw.shape} and converged is {solution.converged}; give one "
            "power flow that has a solution"
        )
    source_pu = source_voltage(feeder, p_kw, source_voltage_pu)
    q_kvar, ratio, state = control_inputs(feeder, q_kvar, control)
    if not feeder.is_radial:
        from dcgrid_env.powerflow.unbalanced.newton_adjoint import voltage_slopes  # brings SciPy with it

        positions = np.arange(feeder.n_node) if nodes is None else np.array(nodes)
        by_p, by_q = voltage_slopes(feeder, (p_kw, q_kvar, source_pu, ratio, state), solution, positions)
        return Linearised(-1000.0 * by_p, -1000.0 * by_q)
    rows = np.eye(feeder.n_node) if nodes is None else np.zeros((len(nodes), feeder.n_node))
    if nodes is not None:
        rows[np.arange(len(nodes)), nodes] = 1.0
    n, n_load = len(rows), feeder.first_device_leg
    inputs = tuple(np.broadcast_to(a, (n, *np.shape(a))) for a in (p_kw, q_kvar, source_pu, ratio, state))
    amperes = np.concatenate((solution.i_re_a, solution.i_im_a))
    of_nodes = (n, 2 * feeder.n_node)
    solved = np.broadcast_to(solution.restart, of_nodes), np.broadcast_to(amperes, of_nodes)
    weights, converged = (rows, None, None, ()), np.ones(n, np.bool_)
    d_p, d_q, *_ = derivatives(feeder, inputs, solved, weights, converged, _groups(n))
    return Linearised(-1000.0 * d_p[:, n_load:], -1000.0 * d_q[:, n_load:])


def _groups(n: int) -> list[slice]:
    """Make groups of rows that sweep as often as their slowest row: 32 rows, as in blocks, of each half of many."""
    ends = [0, n] if n < 128 else [0, n // 2, n]
    return [slice(i, min(i + 32, end)) for begin, end in pairwise(ends) for i in range(begin, end, 32)]
