"""DistFlow sweeps in array operations: differentiable, on any device, the form for torch.

In depth-first order a subtree is a slice, so the sum over a subtree is a difference of two prefix sums. The sum along
the path to the substation is a prefix sum too, over the tour that adds a branch on the way in and takes it back on the
way out.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import namespace, requires_grad, take_last
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.coverage import Coverage
from dcgrid_env.grid.covered_fields import BALANCED
from dcgrid_env.grid.feeder import Feeder
from dcgrid_env.grid.per_unit import S_BASE_KVA
from dcgrid_env.powerflow.solution import (
    LINEAR_SWEEPS,
    LINEAR_TOLERANCE,
    LINEAR_TOLERANCE_32,
    V_SQ_CEILING,
    V_SQ_FLOOR,
    Array,
    PowerFlowError,
    Solution,
)

COVERED = Coverage(BALANCED)
"""Feeders that the array operations cover."""


class Tree(NamedTuple):
    """One feeder in depth-first order, for one kind of array; position 0 is the substation."""

    order: Array  # bus at each position
    place: Array  # position of each bus
    parent: Array  # position that feeds each position; the substation feeds itself
    end: Array  # position after the last of each subtree
    tour: Array  # the tour, as indices into the 2 n terms (drop, -drop)
    enter: Array  # where in the tour each position's own drop stands
    r: Array
    x: Array
    shunt: Array | None  # draw of active and of reactive power by the shunt at each position at 1 p.u., (2, n)
    ratio: Array | None  # of each bus, not position: reported voltage over referred voltage


@cached_on_owner
def tree(feeder: Feeder, xp: ModuleType, dtype: object, device: object) -> Tree:
    """Index and impedance arrays of a feeder, made once for each kind, precision and device of array.

    PowerFlowError for a feeder that the array operations do not cover.
    """
    if unknown := COVERED.first_unknown(feeder):
        raise PowerFlowError(f"feeder {feeder.name!r}: array operations do not cover {unknown}; give NumPy arrays")
    order, place, parent, end = feeder.depth_first
    n = len(order)
    tour: list[int] = []
    inside: list[int] = []
    enter = np.empty(n, dtype=np.int64)
    for k in range(n):
        while inside and end[inside[-1]] <= k:
            tour.append(inside.pop() + n)
        inside.append(k)
        enter[k] = len(tour)
        tour.append(k)
    indices = [order, place, parent, end, np.array(tour), enter]
    z = [np.concatenate(([0.0], z_pu[order[1:] - 1])) for z_pu in (feeder.r_pu, feeder.x_pu)]
    shunts, ratio = feeder.shunts_pu, feeder.voltage_ratio
    if shunts is not None:
        shunts = shunts[:, order] * np.array([[1.0], [-1.0]])

    def figures(values: np.ndarray | None) -> Array:
        return None if values is None else xp.asarray(values.copy(), dtype=dtype, device=device)

    return Tree(
        *(xp.asarray(np.array(i, dtype=np.int64), device=device) for i in indices),
        *map(figures, (*z, shunts, ratio)),
    )


def distflow_arrays(
    feeder: Feeder, p_kw: Array, q_kvar: Array, v0_pu: Array, warm: Array | None, tolerance: float, max_sweeps: int
) -> Solution:
    """Solve as ``distflow`` does, with array operations alone. ``v0_pu`` has the loads' leading shape.

    While a derivative is recorded a warm start is set aside: the derivative converges sweep by sweep like the voltage,
    and a start near the answer would stop before it has.
    """
    xp = namespace(p_kw)
    if requires_grad(p_kw, q_kvar, v0_pu):
        warm = None
    solution = _sweeps(feeder, p_kw, q_kvar, v0_pu, warm, tolerance, max_sweeps)
    keep = solution.converged
    if warm is None or bool(xp.all(keep)):
        return solution
    cold = _sweeps(feeder, p_kw, q_kvar, v0_pu, None, tolerance, max_sweeps)
    pairs = zip(solution, cold, strict=True)
    return Solution(*(xp.where(keep if a.ndim == keep.ndim else keep[..., None], a, b) for a, b in pairs))


def lindistflow_arrays(feeder: Feeder, p_kw: Array, q_kvar: Array, v0_pu: Array) -> Solution:
    """Solve as ``lindistflow`` does, with array operations alone."""
    xp = namespace(p_kw)
    t = tree(feeder, xp, p_kw.dtype, p_kw.device)
    load, z = _load_and_impedance(t, p_kw, q_kvar)
    tolerance = LINEAR_TOLERANCE if p_kw.dtype == xp.float64 else LINEAR_TOLERANCE_32
    v0_sq = (v0_pu * v0_pu)[..., None]
    v_sq = v0_sq + 0.0 * load[0]
    sweeps = 0
    while True:
        sweeps += 1
        flow = _subtree_sums(t, load if t.shunt is None else load + _drawn_by_shunts(t, v_sq))
        new_v_sq = v0_sq - _path_sums(t, 2.0 * xp.sum(z * flow, axis=0))
        off = 0.0 * v0_pu if t.shunt is None else _shunt_change(t, new_v_sq, v_sq)
        v_sq = new_v_sq
        alive = (xp.min(v_sq, axis=-1) > V_SQ_FLOOR) & (xp.max(v_sq, axis=-1) < V_SQ_CEILING)
        if sweeps == LINEAR_SWEEPS or not bool(xp.any(alive & (off > tolerance))):
            break
    good = alive & (off <= tolerance)
    iterations = xp.zeros_like(v0_pu, dtype=xp.int64) + sweeps
    residual = xp.where(good, off, xp.inf)
    return _solution(t, xp.clip(v_sq, V_SQ_FLOOR, V_SQ_CEILING), flow, 0.0 * load[0], good, iterations, residual)


def _load_and_impedance(t: Tree, p_kw: Array, q_kvar: Array) -> tuple[Array, Array]:
    """Per-unit load (2, ..., n) in depth-first order and impedance broadcast against it."""
    xp = namespace(p_kw)
    load = xp.stack((take_last(p_kw, t.order), take_last(q_kvar, t.order))) / S_BASE_KVA
    z = xp.reshape(xp.stack((t.r, t.x)), (2,) + (1,) * (p_kw.ndim - 1) + (p_kw.shape[-1],))
    return load, z


def _drawn_by_shunts(t: Tree, v_sq: Array) -> Array:
    """Power drawn by the shunts, per unit, (2, ..., n) in depth-first order."""
    shunt: Any = t.shunt
    return namespace(v_sq).stack((shunt[0] * v_sq, shunt[1] * v_sq))


def _shunt_change(t: Tree, v_sq: Array, before: Array) -> Array:
    """Largest change of a shunt's active or reactive power between two voltages, per unit, (...)."""
    xp, shunt = namespace(v_sq), t.shunt
    return xp.max(xp.abs(v_sq - before) * xp.max(xp.abs(shunt), axis=0), axis=-1)


def _subtree_sums(t: Tree, values: Array) -> Array:
    xp = namespace(values)
    prefix = xp.cumulative_sum(values, axis=-1, include_initial=True)
    return take_last(prefix, t.end) - prefix[..., :-1]


def _path_sums(t: Tree, drop: Array) -> Array:
    xp = namespace(drop)
    terms = take_last(xp.concat((drop, -drop), axis=-1), t.tour)
    return take_last(xp.cumulative_sum(terms, axis=-1), t.enter)


def _sweeps(
    feeder: Feeder, p_kw: Array, q_kvar: Array, v0_pu: Array, warm: Array | None, tolerance: float, max_sweeps: int
) -> Solution:
    xp = namespace(p_kw)
    t = tree(feeder, xp, p_kw.dtype, p_kw.device)
    load, z = _load_and_impedance(t, p_kw, q_kvar)
    z_sq = t.r * t.r + t.x * t.x
    z_max = xp.maximum(t.r, t.x)
    v0_sq = (v0_pu * v0_pu)[..., None]
    current_sq = 0.0 * load[0]
    if warm is not None:
        current_sq = take_last(xp.concat((current_sq[..., :1], warm), axis=-1), t.order)
    flow, v_sq = load, v0_sq + 0.0 * load[0]
    active = xp.ones_like(v0_pu, dtype=xp.bool)
    good = ~active
    iterations = xp.zeros_like(v0_pu, dtype=xp.int64)
    residual = 0.0 * v0_pu
    for _ in range(max_sweeps):
        drawn = load if t.shunt is None else load + _drawn_by_shunts(t, v_sq)
        new_flow = _subtree_sums(t, drawn + z * current_sq)
        new_v_sq = v0_sq - _path_sums(t, 2.0 * xp.sum(z * new_flow, axis=0) - z_sq * current_sq)
        alive = (xp.min(new_v_sq, axis=-1) > V_SQ_FLOOR) & (xp.max(new_v_sq, axis=-1) < V_SQ_CEILING)
        # The floor keeps rows without a solution finite, so that they spoil neither values nor derivatives.
        new_v_sq = xp.clip(new_v_sq, V_SQ_FLOOR, V_SQ_CEILING)
        new_current_sq = xp.sum(new_flow * new_flow, axis=0) / take_last(new_v_sq, t.parent)
        off = xp.max(xp.abs(new_current_sq - current_sq) * z_max, axis=-1)
        if t.shunt is not None:
            off = xp.maximum(off, _shunt_change(t, new_v_sq, v_sq))
        off = xp.where(alive, off, xp.inf)
        if bool((active & alive).all()):
            flow, v_sq, current_sq = new_flow, new_v_sq, new_current_sq
        else:
            on = active[..., None]
            flow, v_sq = xp.where(on, new_flow, flow), xp.where(on, new_v_sq, v_sq)
            current_sq = xp.where(on & alive[..., None], new_current_sq, current_sq)
        residual = xp.where(active, off, residual)
        iterations = iterations + xp.astype(active, xp.int64)
        good = good | (active & (off <= tolerance))
        active = active & alive & (off > tolerance)
        if not bool(xp.any(active)):
            break
    return _solution(t, v_sq, flow, current_sq, good, iterations, residual)


def _solution(
    t: Tree, v_sq: Array, flow: Array, current_sq: Array, good: Array, iterations: Array, residual: Array
) -> Solution:
    xp = namespace(v_sq)
    branch = t.place[1:]
    current_sq_pu = take_last(current_sq, branch)
    v_pu = xp.sqrt(take_last(v_sq, t.place))
    return Solution(
        v_pu=v_pu if t.ratio is None else v_pu * t.ratio,
        p_branch_kw=take_last(flow[0], branch) * S_BASE_KVA,
        q_branch_kvar=take_last(flow[1], branch) * S_BASE_KVA,
        current_sq_pu=current_sq_pu,
        loss_kw=xp.sum(t.r * current_sq, axis=-1) * S_BASE_KVA,
        converged=good,
        iterations=iterations,
        residual_kva=residual * S_BASE_KVA,
        restart=current_sq_pu,
    )
