"""From a batch of solved power flows to the compiled derivative and back, with and without loops.

With loops, the powers S through the break points follow from the loads p by F(y(p, S)) = 0. Here y is the solution of
the opened feeder, and F are the differences of the two voltages at each break point (see ``looped``). The derivative of
a weighted sum L(y) is then

    dL/dp - mu dF/dp        with mu such that mu dF/dS = dL/dS

Each row of the derivatives of F, and that of L, is one adjoint of the opened feeder.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.core.threads import over_rows
from dcgrid_env.grid.feeder import Feeder
from dcgrid_env.grid.per_unit import S_BASE_KVA
from dcgrid_env.powerflow.balanced.adjoint import TOLERANCE, distflow_adjoint_rows
from dcgrid_env.powerflow.balanced.batch import constants
from dcgrid_env.powerflow.balanced.looped import Loops, loops_of

FloatArray = NDArray[Any]
_ROWS = 64
"""Rows with loops that are differentiated together, so that their adjoints stay in the cache."""


def distflow_adjoint(
    feeder: Feeder, solved: tuple[FloatArray, ...], weights: tuple[FloatArray, ...], converged: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the derivatives of sum(weights * solved) by p_kw and q_kvar (row, bus) and by v0_pu (row,).

    Parameters
    ----------
    feeder
        Any balanced feeder.
    solved
        v_pu (row, bus), p_branch_kw, q_branch_kvar and current_sq_pu (row, branch) of solutions by ``distflow``.
    weights
        Weights of these, and of loss_kw (row,).
    converged
        Whether each row is solved, (row,). A row without a solution has no derivative and gets 0.
    """
    if feeder.loop_ends is None:
        return _adjoint(feeder, solved, weights, converged)
    parts = []
    for first in range(0, max(len(converged), 1), _ROWS):
        cut = slice(first, first + _ROWS)
        figures, of_sum = (tuple(values[cut] for values in arrays) for arrays in (solved, weights))
        parts.append(_looped_adjoint(feeder, figures, of_sum, converged[cut]))
    d_p, d_q, d_v0 = (np.concatenate(derivatives) for derivatives in zip(*parts, strict=True))
    return d_p, d_q, d_v0


def _adjoint(
    feeder: Feeder, solved: tuple[FloatArray, ...], weights: tuple[FloatArray, ...], converged: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    n_row, n = solved[0].shape
    dtype = solved[0].dtype
    of_feeder, tolerance = constants(feeder, dtype.type), TOLERANCE[dtype.itemsize]
    solved, weights = (tuple(map(np.ascontiguousarray, arrays)) for arrays in (solved, weights))
    out = (np.empty((n_row, n), dtype), np.empty((n_row, n), dtype), np.empty(n_row, dtype))
    kernel: Any = distflow_adjoint_rows

    def part(a: int, b: int) -> int:
        cut = slice(a, b)
        solved_part, weights_part, out_part = (tuple(x[cut] for x in arrays) for arrays in (solved, weights, out))
        kernel(*of_feeder, solved_part, weights_part, converged[cut], tolerance, out_part)
        return 0

    over_rows(part, n_row)
    return out


def _looped_adjoint(
    feeder: Feeder, solved: tuple[FloatArray, ...], weights: tuple[FloatArray, ...], converged: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    dtype, n, opened, loops = solved[0].dtype, feeder.n_bus, feeder.opened, loops_of(feeder)
    to = feeder.to_bus[n - 1 :]
    v_pu, *flows = (values.astype(np.float64, copy=False) for values in solved)
    figures = (np.concatenate((v_pu, v_pu[:, to]), axis=1), *flows)
    of_sum = [values.astype(np.float64, copy=False) for values in weights]
    of_sum[0] = np.concatenate((of_sum[0], np.zeros((len(v_pu), feeder.n_loop))), axis=1)
    of_gaps = _gap_weights(feeder, loops, figures)
    repeats = 1 + 2 * feeder.n_loop
    stacked = tuple(
        np.concatenate((summed[None], gaps)).reshape(-1, *summed.shape[1:])
        for summed, gaps in zip(of_sum, of_gaps, strict=True)
    )
    repeated = tuple(np.tile(values, (repeats, 1)) for values in figures)
    derivatives = _adjoint(opened, repeated, stacked, np.tile(converged, repeats))
    by_p, by_q = (values.reshape(repeats, len(v_pu), opened.n_bus) for values in derivatives[:2])
    # Derivatives by S, (2 n_loop figures of S, row): it is drawn at the break point and injected on its other side.
    by_power = np.concatenate([by[..., n:] - by[..., to] for by in (by_p, by_q)], axis=-1).transpose(1, 2, 0)
    matrix = np.where(converged[:, None, None], by_power[..., 1:], np.eye(repeats - 1))
    mu = np.linalg.solve(matrix, by_power[..., :1])[..., 0].T

    def total(derivative: FloatArray) -> FloatArray:
        return (derivative[0] - np.einsum("kr,kr...->r...", mu, derivative[1:])).astype(dtype, copy=False)

    return total(by_p[..., :n]), total(by_q[..., :n]), total(derivatives[2].reshape(repeats, -1))


def _gap_weights(feeder: Feeder, loops: Loops, figures: tuple[FloatArray, ...]) -> list[FloatArray]:
    """Return derivatives of the gaps of squared voltage, then of angle, by the figures of the opened feeder.

    They have the shapes of the weights of ``distflow_adjoint`` behind (2 n_loop, row).
    """
    opened, order = feeder.opened, feeder.opened.depth_first.order
    v_pu, p_kw, q_kvar, current = figures
    n_row, n_loop = len(v_pu), feeder.n_loop
    ratio = np.ones(opened.n_bus) if opened.voltage_ratio is None else opened.voltage_ratio
    by_v, by_p, by_q = (np.zeros((2 * n_loop, n_row, values.shape[1])) for values in (v_pu, p_kw, q_kvar))
    square, slope = (v_pu / ratio) ** 2, 2.0 * v_pu / ratio**2
    for m in range(n_loop):
        end, to = order[loops.end[m]], order[loops.to[m]]
        by_v[m, :, end], by_v[m, :, to] = slope[:, end], -slope[:, to]
        cut = slice(loops.first[m], loops.first[m + 1])
        branch = order[loops.branch[cut]] - 1
        sender, r, x = opened.parent[branch], opened.r_pu[branch], opened.x_pu[branch]
        p, q = p_kw[:, branch] / S_BASE_KVA, q_kvar[:, branch] / S_BASE_KVA
        across, along = x * p - r * q, square[:, sender] - r * p - x * q
        sign = np.where(np.arange(cut.start, cut.stop) < loops.middle[m], 1.0, -1.0)
        by_across, by_along = (side * sign / (across**2 + along**2) for side in (along, -across))
        gap = n_loop + m
        by_p[gap][:, branch] = (x * by_across - r * by_along) / S_BASE_KVA
        by_q[gap][:, branch] = (-r * by_across - x * by_along) / S_BASE_KVA
        np.add.at(by_v[gap].T, sender, (by_along * slope[:, sender]).T)
    return [by_v, by_p, by_q, np.zeros((2 * n_loop, *current.shape)), np.zeros((2 * n_loop, n_row))]
