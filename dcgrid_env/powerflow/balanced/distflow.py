"""Exact DistFlow, the nonlinear power flow of a balanced feeder, with losses.

For branch i -> j with series r + jx, sending-end flow P + jQ, squared current l and squared voltage v:

    P_ij = p_j + sum_k P_jk + r l        l = (P_ij^2 + Q_ij^2) / v_i
    Q_ij = q_j + sum_k Q_jk + x l        v_j = v_i - 2 (r P_ij + x Q_ij) + (r^2 + x^2) l

M. E. Baran, F. F. Wu, "Network reconfiguration in distribution systems for loss reduction and load balancing",
IEEE Trans. Power Delivery 4(2), 1989. Solved by backward sums of flow and forward sums of voltage drop; a branch
without impedance is exact. The residual is the mismatch of the first two equations; the others hold at every sweep.
The sweeps find the solution of high voltage for loads up to 99.997 % of the feeder's limit, and for injections that
raise the voltage up to some 1.4 times the substation's. Beyond that they may not settle, see ``converged``.

Shunts of the feeder draw shunt_kw v_j and inject shunt_kvar v_j at bus j, in addition to its load. The residual then
includes the change of their power in the last sweep. All quantities are referred to the substation's base voltage, and
only the reported voltage of a bus is multiplied by its ``voltage_ratio``.

A feeder with loops is opened to a radial one, and the powers through its break points are found with the sweeps: see
``looped``. Their largest change in the last sweep is then part of the residual. The branches that close the loops are
like all others in the solution. Such feeders are solved in NumPy arrays and in tensors on the CPU.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from array_api_compat import is_torch_array

from dcgrid_env.core.arrays import namespace
from dcgrid_env.grid.feeder import Feeder, FeederError
from dcgrid_env.grid.per_unit import S_BASE_KVA
from dcgrid_env.powerflow.inputs import check_feeder, check_loads, check_stop, substation_voltage, warm_start
from dcgrid_env.powerflow.solution import Array, Solution, raise_not_finite

TOLERANCE_KVA = {8: 1e-4, 4: 1e-2}
"""Default largest power mismatch, kVA, by bytes a figure: 1e-4 keeps voltages within 1e-8 p.u. on the named feeders."""
MAX_SWEEPS = 1000


def distflow(
    feeder: Feeder,
    p_kw: Array,
    q_kvar: Array,
    v0_pu: Array | float | None = None,
    *,
    warm: Solution | Array | None = None,
    tolerance_kva: float | None = None,
    max_sweeps: int = MAX_SWEEPS,
) -> Solution:
    """Solve the nonlinear power flow of one feeder or a batch.

    Parameters
    ----------
    feeder
        The feeder. Its base load and its capacitors are not added to ``p_kw`` and ``q_kvar``. Its shunts are, because
        they are part of the grid.
    p_kw, q_kvar
        Net load at each bus (consumption positive), shape (..., n_bus), in the order of ``feeder.bus_ids``: NumPy
        arrays (or lists) or torch tensors on one device, of real numbers. Two of float32 are solved in float32,
        everything else in float64.
    v0_pu
        Substation voltage, p.u., a number or an array that broadcasts to shape (...), of the loads' kind or NumPy's;
        the feeder's published one by default.
    warm
        A solution (or its ``restart``) of similar loads and the same shape to start from. A start that does not
        converge, such as NaN, is discarded.
    tolerance_kva
        Largest power mismatch of a converged solution, a positive number; 1e-4 kVA in float64, 1e-2 in float32 by
        default.
    max_sweeps
        Sweeps after which a feeder is given up, a whole number of at least 1.

    Returns
    -------
    Solution
        With ``converged`` per feeder; loads without a solution are reported there, not raised.

    Raises
    ------
    PowerFlowError
        If ``feeder`` is not a Feeder. If loads, ``v0_pu`` or a warm start are not real numbers (complex, bool, text,
        masked, sparse or objects) or have the wrong shape. If loads are not finite, or a voltage, tolerance or number
        of sweeps is invalid.
    FeederError
        For a feeder with loops and arrays that are neither NumPy's nor tensors on the CPU.
    """
    check_feeder(feeder)
    p_kw, q_kvar = check_loads(feeder, p_kw, q_kvar)
    if feeder.loop_ends is not None and not (isinstance(p_kw, np.ndarray) or _is_tensor_on_cpu(p_kw)):
        raise FeederError(
            f"feeder {feeder.name!r} has {feeder.n_loop} loops, which are not solved on {p_kw.device}; give NumPy "
            "arrays or tensors on the CPU"
        )
    start = warm_start(feeder, p_kw, warm)
    check_stop(tolerance_kva, max_sweeps)
    if tolerance_kva is None:
        tolerance_kva = TOLERANCE_KVA[p_kw.dtype.itemsize]
    # Python's own numbers: the kernels are compiled for these.
    tolerance, max_sweeps = float(tolerance_kva) / S_BASE_KVA, int(max_sweeps)
    v0 = substation_voltage(feeder, p_kw, v0_pu)
    if not isinstance(p_kw, np.ndarray):
        if _is_tensor_on_cpu(p_kw):
            from dcgrid_env.powerflow.balanced.implicit import distflow_tensors as solve
        else:
            from dcgrid_env.powerflow.balanced.prefix import distflow_arrays as solve

        solution = solve(feeder, p_kw, q_kvar, v0, start, tolerance, max_sweeps)
        if not bool(namespace(p_kw).all(solution.converged)):
            raise_not_finite(feeder, p_kw, q_kvar)
        return solution
    return kernels().solve_rows("distflow", feeder, p_kw, q_kvar, v0, start, tolerance, max_sweeps)


def _is_tensor_on_cpu(values: Array) -> bool:
    return is_torch_array(values) and values.device.type == "cpu"


@cache
def kernels() -> Any:
    """The module of compiled kernels, imported on first use: it brings the compiler with it."""
    from dcgrid_env.powerflow.balanced import batch

    return batch
