"""The power flow of a batch of rows on several feeders: that of each feeder's rows in turn."""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.grid.random_feeders.feeder_batch import FeederBatch
from dcgrid_env.powerflow.balanced.solvers import solve_distflow, solve_lindistflow
from dcgrid_env.powerflow.control import Control
from dcgrid_env.powerflow.solution import Solution


def distflow_of_members(
    feeder: FeederBatch,
    p_kw: Array,
    q_kvar: Array,
    source_voltage_pu: Array | float | None,
    control: Control | None = None,
    start: Array | None = None,
) -> Solution:
    """Solve DistFlow on NumPy arrays (row, n_node), each row on its feeder; see ``solver.Solver``."""
    return _of_members(solve_distflow, feeder, p_kw, q_kvar, source_voltage_pu, control, start)


def lindistflow_of_members(
    feeder: FeederBatch,
    p_kw: Array,
    q_kvar: Array,
    source_voltage_pu: Array | float | None,
    control: Control | None = None,
    start: Array | None = None,
) -> Solution:
    """Solve LinDistFlow on NumPy arrays (row, n_node), each row on its feeder; see ``solver.Solver``."""
    return _of_members(solve_lindistflow, feeder, p_kw, q_kvar, source_voltage_pu, control, start)


def _of_members(
    solve: Any,
    feeder: FeederBatch,
    p_kw: Array,
    q_kvar: Array,
    v0_pu: Array | float | None,
    control: Control | None,
    start: Array | None,
) -> Any:
    whole: list[Any] | None = None
    for member, rows in feeder.members:
        changed = None if control is None else Control(*(None if field is None else field[rows] for field in control))
        solved = solve(member, p_kw[rows], q_kvar[rows], v0_pu, changed, None if start is None else start[rows])
        if whole is None:
            whole = [np.empty((len(p_kw), *values.shape[1:]), values.dtype) for values in solved]
        for values, part in zip(whole, solved, strict=True):
            values[rows] = part
    assert whole is not None
    return Solution(*whole)
