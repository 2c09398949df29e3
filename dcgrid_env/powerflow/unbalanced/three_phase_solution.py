"""What the power flow of a three-phase feeder returns, and the flows at the sending ends that follow from it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.core.arrays import Array, namespace
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.grid.three_phase_matrices import PHASE_BASE_KVA
from dcgrid_env.powerflow.control import Control
from dcgrid_env.powerflow.solution import PowerFlowError

_DEGREES = 180.0 / np.pi


class ThreePhaseSolution(NamedTuple):
    """Voltages and currents of a batch of three-phase feeders; leading dimensions are those of the loads.

    If ``converged`` is False, the solver found no solution, most likely because none exists. All figures are then
    finite but not a solution, except for the residual, which may be infinite. Only the figure ``restart`` has a
    derivative through the iterations.
    """

    v_pu: Array
    """Voltage magnitude from each node to ground, p.u. of its bus's line-to-neutral base, shape (..., n_node)."""
    v_re_pu: Array
    """Real part of the voltage, p.u., shape (..., n_node)."""
    v_im_pu: Array
    """Imaginary part of the voltage, p.u., shape (..., n_node)."""
    i_re_a: Array
    """Real part of the current that the branch which feeds the node's bus brings to it, A, shape (..., n_node)."""
    i_im_a: Array
    """Imaginary part of that current, A, shape (..., n_node). At the source's nodes it is the source's current."""
    loss_kw: Array
    """Active loss of all branches and transformer cores, without the source's own impedance, kW, shape (...)."""
    source_p_kw: Array
    """Active power out of the source at its bus, kW, shape (...)."""
    source_q_kvar: Array
    """Reactive power out of the source at its bus, kvar, shape (...)."""
    converged: Array
    """Whether the voltages are within the tolerance, bool, shape (...)."""
    iterations: Array
    """Sweeps done, int, shape (...); 1 from a solution of Newton's method."""
    residual_kva: Array
    """Estimated largest error of a voltage, p.u., times 1 MVA, kVA, shape (...): what it moves the power of a node by
    that draws 1 MVA at constant current."""
    restart: Array
    """Start for the next, similar power flow, shape (..., 2 n_unknown); a row of zeros means without a start.

    Real and imaginary parts of the voltages, and then of the couplers' currents where there are nodal equations.
    """

    @property
    def v_angle_deg(self) -> Array:
        """Angle of the voltage, degrees, shape (..., n_node)."""
        return namespace(self.v_pu).atan2(self.v_im_pu, self.v_re_pu) * _DEGREES

    @property
    def i_a(self) -> Array:
        """Magnitude of the current that its branch brings to each node, A, shape (..., n_node)."""
        return (self.i_re_a * self.i_re_a + self.i_im_a * self.i_im_a) ** 0.5


class BranchFlows(NamedTuple):
    """What enters each branch at its sending end, by branch and phase of the bus that it feeds, padded with 0.

    Phases follow those of the fed bus; shapes are (..., n_branch, 3). A line's charging at its sending end is in it.
    """

    current_a: NDArray[np.complex128]
    p_kw: NDArray[np.float64]
    q_kvar: NDArray[np.float64]


def branch_flows(feeder: ThreePhaseFeeder, solution: ThreePhaseSolution, control: Control | None = None) -> BranchFlows:
    """Currents and power into the sending ends of the branches; NumPy arrays.

    Parameters
    ----------
    feeder, solution
        The feeder and what its power flow returned, as NumPy arrays.
    control
        The control that the solution was made with, whose ``tap_ratio`` counts.

    Raises
    ------
    PowerFlowError
        For a feeder that is not radial: its branches have more than two ends.
    """
    if not feeder.is_radial:
        raise PowerFlowError(f"feeder {feeder.name!r}: branch flows are known of radial feeders only")
    v = np.asarray(solution.v_re_pu) + 1j * np.asarray(solution.v_im_pu)
    i_a = np.asarray(solution.i_re_a) + 1j * np.asarray(solution.i_im_a)
    ratio = feeder.tap_ratio(feeder.base_tap) if control is None or control.tap_ratio is None else control.tap_ratio
    ratio = np.broadcast_to(ratio, (*v.shape[:-1], feeder.n_regulator))
    current = np.zeros((*v.shape[:-1], feeder.n_branch, 3), np.complex128)
    power = np.zeros_like(current)
    branches = feeder.branches
    for k in range(feeder.n_branch):
        receiving = range(feeder.first_node[k + 1], feeder.first_node[k + 2])
        size, sender, base_kv = len(receiving), feeder.node_parent[receiving.start : receiving.stop], feeder.base_kv_ln
        base_a = PHASE_BASE_KVA / base_kv[feeder.parent[k]]
        through = i_a[..., receiving.start : receiving.stop] / (PHASE_BASE_KVA / base_kv[k + 1])
        tapped = branches.regulator[k + 1, :size]
        if (tapped >= 0).any():
            through = through * ratio[..., tapped]
        into = through @ branches.a[k + 1, :size, :size] * base_a
        into = into + 1j * v[..., sender] @ branches.sending_shunt[k + 1, :size, :size] * base_a
        current[..., k, :size] = into
        power[..., k, :size] = v[..., sender] * base_kv[feeder.parent[k]] * np.conj(into)
    return BranchFlows(current, power.real, power.imag)
