"""LinDistFlow: DistFlow without its loss terms, v = v0^2 - 2 (R p + X q) with v the squared voltage.

M. E. Baran, F. F. Wu, "Optimal capacitor placement on radial distribution systems", IEEE Trans. Power Delivery 4(1),
1989. R and X are the sums of r and x over the path that two buses share to the substation.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.arrays import namespace
from dcgrid_env.grid.feeder import Feeder, FeederError
from dcgrid_env.powerflow.balanced.distflow import kernels
from dcgrid_env.powerflow.inputs import check_feeder, check_loads, substation_voltage
from dcgrid_env.powerflow.solution import Array, Solution, raise_not_finite


def lindistflow(feeder: Feeder, p_kw: Array, q_kvar: Array, v0_pu: Array | float | None = None) -> Solution:
    """Solve the lossless linearised power flow; arguments, result and errors as for :func:`distflow`.

    Currents and losses are zero; ``converged`` is False where the load drives a squared voltage to zero.
    A shunt's power goes with the voltage, so that a feeder with shunts takes several passes, until it settles.
    FeederError for a feeder with loops, where the flows do not follow from the loads behind a branch.
    """
    check_feeder(feeder)
    if feeder.loop_ends is not None:
        raise FeederError(
            f"feeder {feeder.name!r} has {feeder.n_loop} loops, which LinDistFlow does not solve; solve by distflow"
        )
    p_kw, q_kvar = check_loads(feeder, p_kw, q_kvar)
    v0 = substation_voltage(feeder, p_kw, v0_pu)
    if not isinstance(p_kw, np.ndarray):
        from dcgrid_env.powerflow.balanced.prefix import lindistflow_arrays

        solution = lindistflow_arrays(feeder, p_kw, q_kvar, v0)
        if not bool(namespace(p_kw).all(solution.converged)):
            raise_not_finite(feeder, p_kw, q_kvar)
        return solution
    return kernels().solve_rows("lindistflow", feeder, p_kw, q_kvar, v0)
