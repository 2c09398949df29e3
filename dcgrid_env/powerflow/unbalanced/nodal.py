"""The nodal equations of a three-phase feeder that is not radial, factored once for the compiled solution.

The unknowns x are the voltages of all nodes and the currents of the couplers (``grid.nodal_matrices``). With the
currents J(V) that legs, capacitors and cores draw, and s what the ideal source feeds into its bus,

    M x = s - J(V)          M = (Y, C; C^T, -r^2 z) is symmetric

C has r at the winding f of a coupler and -1 at t. Couplers of one line have mutual impedances next to their z. M is
factored at the base taps. At other taps the difference times the last x goes to the right-hand side. It couples only by
what a tap changes, so it converges faster than the legs' currents do.
"""

from __future__ import annotations

from heapq import heapify, heappop, heappush
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix
from scipy.sparse.linalg import SuperLU, splu

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.grid.nodal_matrices import GROUND
from dcgrid_env.grid.topology import FeederError

MOST_NEIGHBOURS = 8
"""Unknowns without a draw that have more neighbours are taken in turn with the others."""
MOST_SHARE = 0.25
"""Share of nodes with devices above which all nodes count as such."""
MOST_KEPT = 16
"""Layouts that are kept, for as many sets of nodes with devices."""
LEAST_PIVOT = 1e-11
"""Pivot, as a share of the diagonal that it came from, below which a node has no connection to ground but rounding."""


class Nodal(NamedTuple):
    """Factors and other matrices as arrays, rows one after the other; indices are unsigned.

    Unknowns are the nodes and then the couplers. Ground is node ``n_node``. Each sweep solves the rows that the
    unknowns with a draw depend on. The rest follow once at the end.
    """

    row: np.ndarray
    """Rows of the factors that each sweep solves, rising, (n_solved,)."""
    equation: np.ndarray
    """Equation that each of them is, (n_solved,)."""
    unknown: np.ndarray
    """Unknown that each of them gives, (n_solved,)."""
    lower_start: np.ndarray
    lower_column: np.ndarray
    lower: np.ndarray
    """Entries of L left of its diagonal of ones, in these rows and columns, real and imaginary, (entry, 2)."""
    upper_start: np.ndarray
    upper_column: np.ndarray
    upper: np.ndarray
    """Entries of U right of its diagonal, in these rows."""
    pivot: np.ndarray
    """Inverse of the diagonal of U in these rows, (n_solved, 2)."""
    rest_row: np.ndarray
    """The other rows, falling, (n_rest,); ``rest_unknown`` and so on are theirs."""
    rest_unknown: np.ndarray
    rest_start: np.ndarray
    rest_column: np.ndarray
    rest: np.ndarray
    rest_pivot: np.ndarray
    place: np.ndarray
    """Row of the factors that each equation is, (n_unknown,)."""
    source_y: np.ndarray
    """Admittance of the source's impedance, (9, 2)."""
    coupler_ends: np.ndarray
    """Nodes of the windings f and t, (n_coupler, 4)."""
    coupler_z: np.ndarray
    """Impedance at the neutral tap, (n_coupler, 2)."""
    coupler_regulator: np.ndarray
    """Row of the regulator, int, (n_coupler,); -1 for a switch or line."""
    base_ratio: np.ndarray
    """Ratio at which the matrix is factored, (n_coupler,)."""
    feed_start: np.ndarray
    feed_column: np.ndarray
    feed: np.ndarray
    """Current brought to each node from voltages, (entry, 2)."""
    feed_coupler: np.ndarray
    """Coupler that feeds each node, int, (n_node,); -1 for none."""
    feed_sign: np.ndarray
    """1 where its current comes to the node and -1 where it goes, (n_node,)."""
    loss_start: np.ndarray
    loss_column: np.ndarray
    loss: np.ndarray
    """Conductances: the loss is V^H G V, (entry,)."""
    mutual_start: np.ndarray
    mutual_column: np.ndarray
    mutual: np.ndarray
    """Resistances between couplers, in whose loss they count, (entry,)."""


class _Factors(NamedTuple):
    lower: csr_matrix
    upper: csr_matrix
    place: np.ndarray
    """Row of the factors that each equation is."""
    column: np.ndarray
    """Column of the factors that each unknown is."""
    drawing: np.ndarray
    """Unknowns whose equation has a right-hand side without devices, or that it depends on, bool."""


def nodal_of(feeder: ThreePhaseFeeder, devices: np.ndarray | None = None) -> Nodal | None:
    """The equations of a feeder for draws of devices at some nodes alone; None for a radial feeder.

    Parameters
    ----------
    feeder
        The feeder.
    devices
        Whether a device may draw, bool, (n_node,); None for all nodes.

    Raises
    ------
    FeederError
        For a node without a connection to ground.
    """
    if feeder.is_radial:
        return None
    if devices is None or devices.sum() > MOST_SHARE * len(devices):
        devices = np.ones(feeder.n_node, bool)
    kept, key = _kept(feeder), devices.tobytes()
    equations = kept.get(key)
    if equations is None:
        if len(kept) >= MOST_KEPT:
            kept.clear()
        equations = kept[key] = _laid_out(feeder, _factors(feeder), devices)
    return equations


@cached_on_owner
def _kept(feeder: ThreePhaseFeeder) -> dict[bytes, Nodal]:
    return {}


def _laid_out(feeder: ThreePhaseFeeder, factors: _Factors, devices: np.ndarray) -> Nodal:
    m, n = feeder.nodal, feeder.n_node
    drawing = factors.drawing.copy()
    drawing[:n] |= devices
    solved = _depending(factors, drawing)
    rows, rest = np.flatnonzero(solved), np.flatnonzero(~solved)[::-1]
    equation, unknown = np.argsort(factors.place), np.argsort(factors.column)
    lower, upper, others = factors.lower[rows], factors.upper[rows], factors.upper[rest]
    lower = lower.multiply(solved[None, :]).tocsr()
    for matrix in (lower, upper, others):
        matrix.eliminate_zeros()
    diagonal: Any = factors.upper.diagonal()
    pivot = 1.0 / diagonal
    loss = m.y.real.copy()  # which shares its indices with m.y
    loss.eliminate_zeros()
    return Nodal(
        row=_index(rows),
        equation=_index(equation[rows]),
        unknown=_index(unknown[rows]),
        **_entries("lower", _without_diagonal(lower, rows)),
        **_entries("upper", _without_diagonal(upper, rows)),
        pivot=_parts(pivot[rows]),
        rest_row=_index(rest),
        rest_unknown=_index(unknown[rest]),
        **_entries("rest", _without_diagonal(others, rest)),
        rest_pivot=_parts(pivot[rest]),
        place=_index(factors.place),
        source_y=_parts(m.source_y.ravel()),
        coupler_ends=_index(np.where(m.coupler_ends == GROUND, n, m.coupler_ends)),
        coupler_z=_parts(m.coupler_z),
        coupler_regulator=m.coupler_regulator.astype(np.int64),
        base_ratio=coupler_ratios(feeder, feeder.tap_ratio(feeder.base_tap)),
        **_entries("feed", m.feed),
        feed_coupler=m.feed_coupler.astype(np.int64),
        feed_sign=m.feed_sign,
        **(_entries("loss", loss) | {"loss": np.ascontiguousarray(loss.data)}),
        **(_entries("mutual", m.coupler_mutual) | {"mutual": np.array(m.coupler_mutual.data).real.copy()}),
    )


def _without_diagonal(matrix: csr_matrix, rows: np.ndarray) -> csr_matrix:
    entries: Any = matrix.tocoo()
    off = rows[entries.row] != entries.col
    return csr_matrix((entries.data[off], (entries.row[off], entries.col[off])), matrix.shape)


def _entries(name: str, matrix: csr_matrix) -> dict[str, np.ndarray]:
    return {f"{name}_start": _index(matrix.indptr), f"{name}_column": _index(matrix.indices), name: _parts(matrix.data)}


def _depending(factors: _Factors, drawing: np.ndarray) -> np.ndarray:
    """Rows of the factors that the unknowns ``drawing`` depend on, or whose right-hand side they change, bool."""
    depends = np.zeros(len(drawing), bool)
    depends[factors.place[drawing]] = True
    depends[factors.column[drawing]] = True
    start, column = factors.lower.indptr, factors.lower.indices
    for k in range(len(depends)):
        depends[k] = depends[k] or depends[column[start[k] : start[k + 1]]].any()
    start, column = factors.upper.indptr, factors.upper.indices
    for k in range(len(depends)):
        if depends[k]:  # also by a row before it
            depends[column[start[k] : start[k + 1]]] = True
    return depends


@cached_on_owner
def _factors(feeder: ThreePhaseFeeder) -> _Factors:
    """Factor the equations once, in an order that takes nodes without a draw first while they have few neighbours."""
    matrix = nodal_matrix(feeder, coupler_ratios(feeder, feeder.tap_ratio(feeder.base_tap)))
    n, ends = feeder.n_node, feeder.nodal.coupler_ends
    drawing = np.ones(n + len(ends), bool)
    drawing[3:n] = False
    for legs in (feeder.load_legs, feeder.capacitor_legs, feeder.core_legs):
        drawing[legs.node] = True
        drawing[legs.other[legs.other >= 0]] = True
    drawing[ends[ends != GROUND]] = True
    order = _order(matrix, drawing)
    factors = _factored(feeder, matrix[order][:, order].tocsc(), order)
    place, column = np.empty_like(order), np.empty_like(order)
    place[order], column[order] = factors.perm_r, factors.perm_c
    return _Factors(factors.L.tocsr(), factors.U.tocsr(), place, column, drawing)


def _order(matrix: csc_matrix, last: np.ndarray) -> np.ndarray:
    """Order of elimination by least degree: all but ``last`` with up to ``MOST_NEIGHBOURS``, then the others."""
    joined = [set(matrix.indices[a:b].tolist()) - {i} for i, (a, b) in enumerate(pairwise(matrix.indptr))]
    left, order = [True] * len(joined), []
    for take in (~last, np.ones_like(last)):
        heap = [(len(joined[i]), i) for i in np.flatnonzero(take).tolist() if left[i]]
        heapify(heap)
        while heap:
            degree, i = heappop(heap)
            if not left[i] or degree != len(joined[i]):
                continue  # it is in the heap with its present degree
            if not take.all() and degree > MOST_NEIGHBOURS:
                break
            left[i] = False
            order.append(i)
            for j in joined[i]:
                joined[j] |= joined[i]
                joined[j] -= {i, j}
            for j in joined[i]:
                if take[j]:
                    heappush(heap, (len(joined[j]), j))
    return np.array(order)


def coupler_ratios(feeder: ThreePhaseFeeder, ratio: Any) -> np.ndarray:
    """Ratio of each coupler under the ratios of the regulators, (n_coupler,)."""
    row = feeder.nodal.coupler_regulator
    return np.where(row >= 0, np.append(ratio, 1.0)[row], 1.0)


def nodal_matrix(feeder: ThreePhaseFeeder, ratio: np.ndarray) -> csc_matrix:
    """The matrix M under these ratios of the couplers."""
    m, n = feeder.nodal, feeder.n_node
    c, size = np.arange(len(ratio)) + n, n + len(ratio)
    entries = m.y.tocoo()
    three = np.arange(3)
    parts = [(entries.data, entries.row, entries.col), (m.source_y.ravel(), np.repeat(three, 3), np.tile(three, 3))]
    for end, value in zip(m.coupler_ends.T, (ratio, -ratio, 0.0 * ratio - 1.0, 0.0 * ratio + 1.0), strict=True):
        there = end != GROUND
        parts += [(value[there], end[there], c[there]), (value[there], c[there], end[there])]
    parts.append((-(ratio**2) * m.coupler_z, c, c))
    mutual: Any = m.coupler_mutual.tocoo()
    parts.append((-mutual.data, mutual.row + n, mutual.col + n))
    values, rows, columns = (np.concatenate(part) for part in zip(*parts, strict=True))
    return csc_matrix((values.astype(np.complex128), (rows, columns)), (size, size))


def _factored(feeder: ThreePhaseFeeder, matrix: csc_matrix, order: np.ndarray) -> SuperLU:
    """The factors of the matrix of the unknowns in this order."""
    failed = FeederError(
        f"feeder {feeder.name!r}: the nodal equations have no unique solution; connect every conductor to ground"
    )
    try:
        factors = splu(matrix, permc_spec="NATURAL", diag_pivot_thresh=0.01, options={"SymmetricMode": True})
    except RuntimeError:  # exactly singular
        raise failed from None
    pivot = np.abs(factors.U.diagonal())
    size = abs(matrix).max(axis=0).toarray().ravel()[np.argsort(factors.perm_c)]
    weak = np.flatnonzero(~(pivot > LEAST_PIVOT * size))
    if len(weak):
        unknown = int(order[np.argsort(factors.perm_c)[weak[0]]])
        if unknown >= feeder.n_node:
            raise failed
        raise FeederError(
            f"feeder {feeder.name!r}: node {feeder.node_ids[unknown]} has no connection to ground; ground a winding "
            "or a neutral of its part of the grid"
        )
    return factors


def _index(values: Any) -> np.ndarray:
    return np.array(values, np.uint64)


def _parts(values: Any) -> np.ndarray:
    return np.stack((values.real, values.imag), axis=-1).reshape(-1, 2)
