"""From NumPy loads of any leading shape to the compiled kernels and back."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.threads import over_rows
from dcgrid_env.grid.feeder import Feeder
from dcgrid_env.powerflow.balanced.compiled_blocks import FEW, MOST_IN_BLOCKS, distflow_blocks
from dcgrid_env.powerflow.balanced.distflow_kernels import distflow_rows, lindistflow_rows
from dcgrid_env.powerflow.balanced.loop_kernels import looped_blocks, looped_rows
from dcgrid_env.powerflow.balanced.looped import at_opened, loops_of
from dcgrid_env.powerflow.solution import Solution, raise_not_finite

_NO_ROWS = {np.float64: np.empty((0, 0)), np.float32: np.empty((0, 0), np.float32)}


@cached_on_owner
def constants(feeder: Feeder, dtype: type) -> tuple[Any, ...]:
    """Constants of a feeder for the kernels, see ``distflow_kernels``."""
    order, parent = feeder.depth_first.order.copy(), feeder.depth_first.parent.copy()  # writable, as kernels want them
    z = (np.concatenate(([0.0], z_pu[order[1:] - 1])).astype(dtype) for z_pu in (feeder.r_pu, feeder.x_pu))
    empty = np.empty(0, dtype)
    shunts, ratio = feeder.shunts_pu, feeder.voltage_ratio
    g, b = (empty, empty) if shunts is None else (shunt_pu[order].astype(dtype) for shunt_pu in shunts)
    return order, parent, *z, g, b, empty if ratio is None else ratio[order].astype(dtype)


def solve_rows(
    method: str, feeder: Feeder, p_kw: Array, q_kvar: Array, v0_pu: Array | float | None, *rest: Any
) -> Solution:
    """Run a kernel over all rows, on several threads where there are many, and shape its output as a Solution.

    ``rest`` contains the other arguments of the kernel: for DistFlow the warm start or None, the tolerance and the
    largest number of sweeps.
    """
    if feeder.loop_ends is not None:
        return _solve_looped(feeder, p_kw, q_kvar, v0_pu, *rest)
    shape, n, dtype = p_kw.shape[:-1], feeder.n_bus, p_kw.dtype
    n_row = p_kw.size // n
    loads = rows(p_kw, (n_row, n)), rows(q_kvar, (n_row, n)), rows(v0_pu, (n_row,))
    if rest:
        warm = rest[0]
        warm = _NO_ROWS[dtype.type] if warm is None else rows(warm, (n_row, n - 1))
        rest = (warm, *rest[1:])
    out = _outputs(n_row, n, dtype)
    kernel, of_feeder = _KERNELS[method], constants(feeder, dtype.type)
    if n_row == 1:
        failed = kernel(*of_feeder, *loads, *rest, out)
    else:
        failed = over_rows(partial(_part, kernel, of_feeder, loads, rest, out), n_row)
    if failed:
        raise_not_finite(feeder, p_kw, q_kvar)
    if len(shape) == 1:
        return Solution(*out, restart=out[3])
    shaped = tuple(a.reshape(*shape, *a.shape[1:]) if shape else a[0] for a in out)
    return Solution(*shaped, restart=shaped[3])


def _outputs(n_row: int, n: int, dtype: Any) -> tuple[np.ndarray, ...]:
    """Arrays that a kernel fills: the fields of ``Solution`` but the last."""
    over_branches = np.empty((3, n_row, n - 1), dtype)
    per_row = np.empty((2, n_row), dtype)
    return (
        np.empty((n_row, n), dtype),
        over_branches[0],
        over_branches[1],
        over_branches[2],
        per_row[0],
        np.empty(n_row, np.bool_),
        np.zeros(n_row, np.int64),
        per_row[1],
    )


def _solve_looped(
    feeder: Feeder,
    p_kw: Array,
    q_kvar: Array,
    v0_pu: Array | float | None,
    warm: Array | None,
    tolerance: float,
    max_sweeps: int,
) -> Solution:
    """Solve DistFlow of a feeder with loops on its opened feeder, in float64 whatever the loads' precision."""
    shape, n, n_open = p_kw.shape[:-1], feeder.n_bus, feeder.opened.n_bus
    n_row = p_kw.size // n
    n_start = feeder.n_branch + 2 * feeder.n_loop
    p, q, v0 = (
        rows(np.asarray(values, np.float64), (n_row, *width))
        for values, width in ((p_kw, (n,)), (q_kvar, (n,)), (v0_pu, ()))
    )
    start = np.empty((0, n_start)) if warm is None else rows(warm.astype(np.float64, copy=False), (n_row, n_start))
    out, restart = _outputs(n_row, n_open, np.float64), np.empty((n_row, n_start))
    of_feeder = (*constants(feeder.opened, np.float64), loops_of(feeder))

    def part(first: int, last: int) -> int:
        cut = slice(first, last)
        loads = (at_opened(feeder, p[cut]), at_opened(feeder, q[cut]), v0[cut])
        of_rows = tuple(values[cut] for values in out)
        return _looped(*of_feeder, *loads, start[cut], tolerance, max_sweeps, of_rows, restart[cut])

    if over_rows(part, n_row):
        raise_not_finite(feeder, p_kw, q_kvar)
    figures = (np.ascontiguousarray(out[0][:, :n]), *out[1:], restart)
    return Solution(
        *(
            (a.astype(p_kw.dtype, copy=False) if a.dtype == np.float64 else a).reshape(*shape, *a.shape[1:])
            if shape
            else a[0].astype(p_kw.dtype if a.dtype == np.float64 else a.dtype)
            for a in figures
        )
    )


def _looped(*arguments: Any) -> int:
    """Solve rows of a feeder with loops, the many in blocks first, as ``_distflow`` does."""
    n_row, n = arguments[8].shape
    if n_row > FEW and n <= MOST_IN_BLOCKS and looped_blocks(*arguments) == 0:
        return 0
    return looped_rows(*arguments)


def _distflow(*arguments: Any) -> int:
    """Solve rows by ``distflow_rows``, after ``distflow_blocks`` if there are many; return how many have no solution.

    Two kernels, so a single environment does not compile code that only many need.
    """
    n_row, n = arguments[7].shape
    if n_row > FEW and n <= MOST_IN_BLOCKS and distflow_blocks(*arguments) == 0:
        return 0
    return distflow_rows(*arguments)


_KERNELS: dict[str, Any] = {"distflow": _distflow, "lindistflow": lindistflow_rows}


def _part(
    kernel: Any,
    of_feeder: tuple[Any, ...],
    loads: tuple[Any, ...],
    rest: tuple[Any, ...],
    out: tuple[Any, ...],
    first: int,
    last: int,
) -> int:
    cut = slice(first, last)
    rest = (rest[0][cut], *rest[1:]) if rest else ()
    return kernel(*of_feeder, *(a[cut] for a in loads), *rest, tuple(a[cut] for a in out))


def rows(values: Array, shape: tuple[int, ...]) -> Array:
    """Contiguous and writable: the one memory layout that the kernels are compiled for."""
    rows = values if values.shape == shape else values.reshape(shape)
    flags = rows.flags
    return rows if flags.c_contiguous and flags.writeable else np.array(rows, order="C")
