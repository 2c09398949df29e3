"""Result of every power-flow method."""

from __future__ import annotations

from typing import NamedTuple

from dcgrid_env.core.arrays import Array, namespace
from dcgrid_env.grid.feeder import Feeder

V_SQ_FLOOR = 1e-4
"""Squared voltage below which the iteration is considered to collapse, as no feeder operates there."""
V_SQ_CEILING = 1e4
"""Nor is one this high: an iteration under impossible injections runs away upwards."""
LINEAR_SWEEPS = 1000
"""Sweeps after which LinDistFlow gives up a feeder whose shunts' power does not settle."""
LINEAR_TOLERANCE = 1e-10
"""Change of a shunt's power, per unit, that a last sweep of LinDistFlow may still make."""
LINEAR_TOLERANCE_32 = 1e-5
"""``LINEAR_TOLERANCE`` in float32."""


class PowerFlowError(ValueError):
    """Input that no power flow can use. A load without a solution is not an error: see ``Solution.converged``."""


class Solution(NamedTuple):
    """Voltages and flows of a batch of feeders; leading dimensions are those of the loads.

    If ``converged`` is False, the solver found no solution, most likely because none exists: the load exceeds the
    feeder's limit. Voltages and flows are then finite but not a solution, and the residual may be infinite.
    """

    v_pu: Array
    """Voltage magnitude, p.u., shape (..., n_node)."""
    p_branch_kw: Array
    """Active power into the sending end of branch k, kW, shape (..., n_branch)."""
    q_branch_kvar: Array
    """Reactive power into the sending end of branch k, kvar, shape (..., n_branch)."""
    current_sq_pu: Array
    """Squared current of branch k, per unit, shape (..., n_branch)."""
    loss_kw: Array
    """Active loss of all branches without the draw of shunts, kW, shape (...)."""
    converged: Array
    """Whether the residual is within the tolerance, bool, shape (...)."""
    iterations: Array
    """Sweeps done, int, shape (...)."""
    residual_kva: Array
    """Largest power mismatch at any bus, kVA, shape (...)."""
    restart: Array
    """Start for the next, similar power flow with the same solver, shape (..., n).

    The content depends on the solver. A row of zeros means without a start.
    """


def raise_not_finite(feeder: Feeder, p_kw: Array, q_kvar: Array) -> None:
    """Find the load that is not finite and raise PowerFlowError naming bus and field; return if there is none."""
    xp = namespace(p_kw)
    for field, values in (("p_kw", p_kw), ("q_kvar", q_kvar)):
        where = xp.nonzero(~xp.isfinite(values))
        if len(where[0]):
            place = tuple(int(i[0]) for i in where)
            raise PowerFlowError(
                f"feeder {feeder.name!r}: {field} of bus {feeder.bus_ids[place[-1]]} is {values[place].item()} in "
                f"scenario {place[:-1]} of the batch; give finite loads"
            )
