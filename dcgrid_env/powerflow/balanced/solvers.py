"""DistFlow and LinDistFlow behind the protocol that all solvers share: see ``dcgrid_env.powerflow.solver``."""

from __future__ import annotations

from dcgrid_env.core.arrays import Array
from dcgrid_env.grid.feeder import Feeder
from dcgrid_env.powerflow.balanced.distflow import distflow
from dcgrid_env.powerflow.balanced.lindistflow import lindistflow
from dcgrid_env.powerflow.control import Control
from dcgrid_env.powerflow.inputs import less_switched_shunts
from dcgrid_env.powerflow.solution import Solution


def solve_distflow(
    feeder: Feeder,
    p_kw: Array,
    q_kvar: Array,
    source_voltage_pu: Array | float | None,
    control: Control | None = None,
    start: Array | None = None,
) -> Solution:
    """Solve by :func:`distflow`; the start and the restart are squared currents of the branches, per unit."""
    if control is not None:
        q_kvar = less_switched_shunts(feeder, p_kw, q_kvar, control)
    return distflow(feeder, p_kw, q_kvar, source_voltage_pu, warm=start)


def solve_lindistflow(
    feeder: Feeder,
    p_kw: Array,
    q_kvar: Array,
    source_voltage_pu: Array | float | None,
    control: Control | None = None,
    start: Array | None = None,
) -> Solution:
    """Solve by :func:`lindistflow`, which has no use for a start."""
    if control is not None:
        q_kvar = less_switched_shunts(feeder, p_kw, q_kvar, control)
    return lindistflow(feeder, p_kw, q_kvar, source_voltage_pu)
