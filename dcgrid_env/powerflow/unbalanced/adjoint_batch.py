"""From weights of any leading shape to the compiled derivative and back."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.threads import over_rows
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.powerflow.unbalanced.nodal import nodal_of
from dcgrid_env.powerflow.unbalanced.plan import plan_of
from dcgrid_env.powerflow.unbalanced.sweep_adjoint import sweep_adjoint_rows
from dcgrid_env.powerflow.unbalanced.sweep_rows import FEW, ONE, WIDE

_NO_ROWS = np.empty((0, 0))


def derivatives(
    feeder: ThreePhaseFeeder,
    inputs: tuple[Any, ...],
    solved: tuple[Any, Any],
    weights: tuple[Any, Any, Any, Sequence[Any]],
    converged: np.ndarray,
    groups: Iterable[slice] | None = None,
) -> tuple[Any, ...]:
    """Derivatives of a weighted sum of a solution's figures by all that the sweep was given.

    Parameters
    ----------
    feeder, given
        Arguments of ``solve_batch``.
    solved
        Its ``restart`` and its currents, real parts first, shape (..., 2 n_node).
    weights
        Those of v_pu (..., n_node), of ``solved`` and, in a sequence, of loss, source p and source q (...); None is 0.
    converged
        Which rows have a solution; the others get 0.
    groups
        Slices that cover all rows; the rows of a slice sweep as often as the slowest of them. The figures then depend
        neither on the number of threads nor on the width of blocks. The rows are solved one at a time, with code that
        compiles in a third of the time. None for the fastest way, whose last bits depend on the number of threads.

    Returns
    -------
    tuple
        By p_kw, q_kvar, source_pu, ratio and state, in the shapes that they have in ``inputs``.
    """
    shape, n = converged.shape, feeder.n_node
    n_row = converged.size
    rows = tuple(_rows(a, n_row, None if k == 2 else a.shape[-1]) for k, a in enumerate(inputs))
    solved = (_rows(solved[0], n_row, 2 * feeder.n_unknown), _rows(solved[1], n_row, 2 * n))
    of_row = np.zeros((3, n_row)) if any(w is not None for w in weights[3]) else np.empty((3, 0))
    for k, weight in enumerate(weights[3]):
        if weight is not None:
            of_row[k] = weight.reshape(n_row)
    widths = (n, 2 * n, 2 * n)
    wide = [
        _NO_ROWS if w is None else _rows(w[..., :width], n_row, width)
        for w, width in zip(weights[:3], widths, strict=True)
    ]
    out = tuple(np.zeros(a.shape) for a in rows)
    plan, nodal, good = plan_of(feeder), nodal_of(feeder), np.ascontiguousarray(converged.reshape(n_row))
    settled = np.ones(n_row, np.bool_)

    def take(width: tuple[int, ...], least: int, first: int, last: int) -> int:
        cut = slice(first, last)
        given_part, solved_part, out_part = (tuple(a[cut] for a in arrays) for arrays in (rows, solved, out))
        of_part = (*(w[cut] for w in wide), np.ascontiguousarray(of_row[:, cut]))
        return sweep_adjoint_rows(
            plan, nodal, width, given_part, solved_part, of_part, good[cut], least, settled[cut], out_part
        )

    if groups is not None:
        for group in groups:
            sweeps = take(ONE, 0, group.start, group.stop)
            take(ONE, sweeps, group.start, group.stop)
    elif n_row:
        over_rows(partial(take, ONE if n_row <= FEW else WIDE, 0), n_row)
    for row in np.flatnonzero(good & ~settled):
        _by_newton(feeder, row, rows, solved, (*wide, of_row), out)
    return tuple(a.reshape((*shape, a.shape[-1]) if a.ndim == 2 else shape) for a in out)


def _by_newton(
    feeder: ThreePhaseFeeder,
    row: Any,
    rows: tuple[Any, ...],
    solved: tuple[Any, ...],
    weights: tuple[Any, ...],
    out: tuple[Any, ...],
) -> None:
    """Put the derivatives of a row whose sweeps did not settle into ``out``."""
    from dcgrid_env.powerflow.unbalanced.newton_adjoint import derivative  # brings SciPy with it

    n = feeder.n_node
    row_weights = [
        w[row] if len(w) else np.zeros(width) for w, width in zip(weights[:3], (n, 2 * n, 2 * n), strict=True)
    ]
    of_row = weights[3][:, row] if weights[3].shape[1] else np.zeros(3)
    row_derivatives = derivative(
        feeder, tuple(a[row] for a in rows), solved[0][row], solved[1][row], (*row_weights, of_row)
    )
    for derivatives_, of_input in zip(out, row_derivatives, strict=True):
        derivatives_[row] = of_input


def _rows(values: Array, n_row: int, width: int | None) -> Array:
    """(row, width) or (row,), float64, contiguous and writable: the one memory layout of the kernel."""
    rows = values.reshape((n_row,) if width is None else (n_row, width))
    good = rows.dtype == np.float64 and rows.flags.c_contiguous and rows.flags.writeable
    return rows if good else np.array(rows, np.float64, order="C")
