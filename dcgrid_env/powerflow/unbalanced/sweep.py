"""The backward and forward sweep: the nonlinear power flow of an unbalanced three-phase radial feeder.

Every branch is Kersting's pair of generalised matrices, V_m = A V_n - B I_m and I_n = A^T I_m (W. H. Kersting,
"Distribution System Modeling and Analysis"), and every leg draws by its own law. Backward, the currents that all legs
draw at the last voltages are added up towards the source; forward, the voltages follow from them. The change of the
voltages falls by a ratio in each sweep. This ratio estimates the remaining error; near a collapse it nears 1.
If the sweeps of NumPy arrays and CPU tensors do not settle, Newton's method is tried (``newton``).
docs/decisions/0010-three-phase.md has the derivation.
"""

from __future__ import annotations

import math
import reprlib
from typing import Any

import numpy as np
from array_api_compat import is_torch_array

from dcgrid_env.core.arrays import Array, all_true
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.powerflow.control import Control
from dcgrid_env.powerflow.inputs import check_stop
from dcgrid_env.powerflow.solution import PowerFlowError
from dcgrid_env.powerflow.unbalanced.three_phase_inputs import (
    check_legs,
    check_three_phase_feeder,
    control_inputs,
    raise_leg_not_finite,
    source_voltage,
    voltages_to_start_from,
)
from dcgrid_env.powerflow.unbalanced.three_phase_solution import ThreePhaseSolution

TOLERANCE_PU = 5e-9
MAX_SWEEPS = 1000


def solve_unbalanced(
    feeder: ThreePhaseFeeder,
    p_kw: Array,
    q_kvar: Array,
    source_voltage_pu: Array | float | None = None,
    control: Control | None = None,
    start: ThreePhaseSolution | Array | None = None,
    *,
    tolerance_pu: float = TOLERANCE_PU,
    max_sweeps: int = MAX_SWEEPS,
) -> ThreePhaseSolution:
    """Solve the power flow of one three-phase feeder or a batch.

    Parameters
    ----------
    feeder
        The feeder. Its base loads are not added; its capacitors are, in the states of ``control``.
    p_kw, q_kvar
        Draw of each leg at its rated voltage, consumption positive, shape (..., n_leg): the legs of the loads first,
        then a constant power from each node to ground. NumPy arrays (or lists) or torch tensors; the figures are
        solved in float64 and returned in the precision of these two.
    source_voltage_pu
        Voltage of the ideal source, p.u., a number or an array that broadcasts to shape (...); the feeder's own by
        default.
    control
        Ratios of the regulators and states of the capacitors; the base taps and states where it is None.
    start
        A solution (or its ``restart``) of a similar power flow of the same shape; a row of zeros, or one that does not
        converge, is discarded.
    tolerance_pu
        Largest estimated error of a voltage of a converged solution, p.u., the sum over the phases of a bus.
    max_sweeps
        Sweeps after which Newton's method is tried, at least 1.

    Returns
    -------
    ThreePhaseSolution
        With ``converged`` per row; loads without a solution are reported there, not raised.

    Raises
    ------
    PowerFlowError
        If ``feeder`` is not a ThreePhaseFeeder. If figures are not real numbers, not finite or have the wrong shape. If
        a tap is out of range, or a voltage, tolerance or number of sweeps is invalid.
    """
    check_three_phase_feeder(feeder)
    p_kw, q_kvar = check_legs(feeder, p_kw, q_kvar)
    _check_stop(tolerance_pu, max_sweeps)
    source_pu = source_voltage(feeder, p_kw, source_voltage_pu)
    q_kvar, ratio, state = control_inputs(feeder, q_kvar, control)
    start = voltages_to_start_from(feeder, p_kw, start)
    return solve_checked(feeder, (p_kw, q_kvar, source_pu, ratio, state), start, float(tolerance_pu), int(max_sweeps))


def solve_checked(
    feeder: ThreePhaseFeeder,
    inputs: tuple[Array, ...],
    start: Array | None,
    tolerance_pu: float = TOLERANCE_PU,
    max_sweeps: int = MAX_SWEEPS,
) -> ThreePhaseSolution:
    """Solve the power flow under inputs that are known to be valid, other than that powers are finite.

    Parameters
    ----------
    feeder
        The feeder.
    inputs
        Draw of each leg, kW and kvar, (..., n_leg); voltage of the source, p.u., (...); ratios of the regulators,
        (..., n_regulator); states of the capacitors, (..., n_capacitor). All of one kind and precision.
    start
        Voltages to start from, p.u., the ``restart`` of a solution, or None.
    tolerance_pu
        Largest estimated error of a voltage of a converged solution, p.u., the sum over the phases of a bus.
    max_sweeps
        Sweeps after which Newton's method is tried, at least 1.

    Raises
    ------
    PowerFlowError
        For a power that is not finite.
    """
    p_kw, q_kvar = inputs[:2]
    if isinstance(p_kw, np.ndarray):
        from dcgrid_env.powerflow.unbalanced.sweep_batch import solve_batch as solve
    elif is_torch_array(p_kw) and p_kw.device.type == "cpu":
        from dcgrid_env.powerflow.unbalanced.sweep_tensors import sweep_tensors as solve
    else:
        from dcgrid_env.powerflow.unbalanced.array_form import sweep_arrays as solve
    solution = solve(feeder, inputs, start, tolerance_pu, max_sweeps)
    if not (all_true(solution.converged) if p_kw.ndim == 2 else bool(solution.converged.all())):
        raise_leg_not_finite(feeder, p_kw, q_kvar)
    return solution


def _check_stop(tolerance_pu: Any, max_sweeps: Any) -> None:
    check_stop(None, max_sweeps)
    real = isinstance(tolerance_pu, int | float | np.integer | np.floating) and not isinstance(tolerance_pu, bool)
    if not real or not 0.0 < tolerance_pu < math.inf:
        raise PowerFlowError(f"tolerance_pu is {reprlib.repr(tolerance_pu)}; give a positive number of p.u.")
