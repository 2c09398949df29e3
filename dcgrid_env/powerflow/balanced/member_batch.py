"""The power flow of a batch of rows on several feeders: that of each feeder's rows in turn."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.grid.random_feeders.feeder_batch import FeederBatch
from dcgrid_env.powerflow.balanced.solvers import solve_distflow, solve_lindistflow
from dcgrid_env.powerflow.control import Control
from dcgrid_env.powerflow.solution import Solution


def _of_members(
    solve: Any,
    feeder: FeederBatch,
    p_kw: Array,
    q_kvar: Array,
    source_voltage_pu: Array | float | None,
    control: Control | None = None,
    start: Array | None = None,
) -> Solution:
    whole: list[Any] | None = None
    for member, rows in feeder.members:
        changed = None if control is None else Control(*(None if field is None else field[rows] for field in control))
        row_start = None if start is None else start[rows]
        solved = solve(member, p_kw[rows], q_kvar[rows], source_voltage_pu, changed, row_start)
        if whole is None:
            whole = [np.empty((len(p_kw), *values.shape[1:]), values.dtype) for values in solved]
        for values, part in zip(whole, solved, strict=True):
            values[rows] = part
    assert whole is not None
    return Solution(*whole)


member_distflow = partial(_of_members, solve_distflow)
"""Solves DistFlow on NumPy arrays (row, n_node), each row on its feeder; see ``solver.Solver``."""
member_lindistflow = partial(_of_members, solve_lindistflow)
"""Solves LinDistFlow in the same way."""
