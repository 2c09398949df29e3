"""Loading of each branch: its current as a share of its rating, at the position of the node that it feeds.

    loading = |I| / rating          of a balanced feeder |I| = |S| / (sqrt(3) V), both at the sending end

A balanced feeder has a branch to each bus except the substation. The branches that close its loops follow behind the
nodes, so branch k is at position k + 1. The current of a branch is that of the series impedance, without
the charging of the line. It is referred to the substation's base voltage, as the rating is. On a three-phase feeder
each phase of a line, switch or transformer counts, with its current at the to-side. A regulator counts with the larger
current of its two sides, which differ by the ratio of its tap. Random feeders have a rating of every branch; rows on
several of them are computed feeder by feeder.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.core.arrays import Array, as_like, namespace, positive_part, positive_sqrt, take_last
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.grid import AnyFeeder, Feeder, ThreePhaseFeeder
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from dcgrid_env.grid.random_feeders.feeder_batch import FeederBatch
from dcgrid_env.powerflow.unbalanced.three_phase_solution import ThreePhaseSolution

NO_VOLTAGE_PU = 1e-12
"""Voltage that keeps a ratio finite where there is none, p.u."""
_SHOWN = 12
"""Branches that a text names."""


def has_ratings(feeder: AnyFeeder | RandomFeeders | FeederBatch) -> bool:
    """Whether the rating of any branch is known, of a feeder, a family of random ones or rows on several of these."""
    if isinstance(feeder, RandomFeeders | FeederBatch):
        return True
    return feeder.rating_a is not None and len(rated_nodes(feeder)) > 0


@cached_on_owner
def rated_nodes(feeder: AnyFeeder | RandomFeeders | FeederBatch) -> NDArray[np.intp]:
    """Positions in the loading of branches, or conductors, whose rating is known."""
    if isinstance(feeder, RandomFeeders | FeederBatch):
        return np.arange(1, feeder.n_bus)
    return np.flatnonzero(~np.isnan(_ratings_a(feeder)))


def n_loading(feeder: AnyFeeder) -> int:
    """Number of positions in the loading."""
    return len(_ratings_a(feeder))


class RatingCoverage(NamedTuple):
    """Number of a feeder's branches with a known rating, and the names of those without."""

    known: int
    of: int
    not_checked: tuple[str, ...]
    """Names of the branches without a rating, as in ``"line 650-632"``."""
    basis: str = ""
    """Season and kind of the ratings, as in ``"summer, normal"``; empty for the ratings without a season."""
    otherwise: tuple[str, ...] = ()
    """Names of the elements without a rating of that season and kind, which another of their ratings limits."""

    def __str__(self) -> str:
        said = f"ratings known for {self.known} of {self.of} elements{f' ({self.basis})' if self.basis else ''}"
        for label, names in (("limited by another rating", self.otherwise), ("not checked", self.not_checked)):
            more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
            said += f"; {label}: {', '.join(names[:_SHOWN])}{more}" if names else ""
        return said


def rating_coverage(feeder: AnyFeeder) -> RatingCoverage:
    """Count the branches whose rating is known, on all phases, and name the others."""
    unknown = np.isnan(_ratings_a(feeder))
    node_bus = np.arange(feeder.n_branch + 1) if isinstance(feeder, Feeder) else feeder.node_bus
    without = set(node_bus[unknown].tolist()) - {0}
    names = tuple(feeder.branch_names[bus - 1] for bus in sorted(without))
    return RatingCoverage(feeder.n_branch - len(names), feeder.n_branch, names)


def branch_loading(feeder: AnyFeeder | FeederBatch, solution: Any) -> Array:
    """Current of the branch that feeds each node as a share of its rating, 0 without a rating.

    The shape is (..., n_node + n_loop): the branches that close loops of a balanced feeder follow behind the nodes.

    ``solution`` is of a power flow of the feeder; the linearised one has currents too, from its flows and voltages.
    """
    if isinstance(feeder, FeederBatch):
        loading = np.zeros(solution.v_pu.shape)
        for member, rows in feeder.members:
            flows = (solution.v_pu[rows], solution.p_branch_kw[rows], solution.q_branch_kvar[rows])
            loading[rows] = branch_loading(member, _Flows(*flows))
        return loading
    if not isinstance(feeder, Feeder):
        return _three_phase_loading(feeder, solution)
    per_a = as_like(inverse_ratings(feeder), solution.v_pu)
    xp, p, q = namespace(solution.v_pu), solution.p_branch_kw, solution.q_branch_kvar
    v_pu = solution.v_pu
    if feeder.voltage_ratio is not None:
        v_pu = v_pu / as_like(feeder.voltage_ratio, v_pu)
    current_a = positive_sqrt(p * p + q * q) / take_last(v_pu, _parents(feeder, xp, v_pu.device))
    loading = current_a * (per_a[1:] / (3.0**0.5 * feeder.base_kv))
    return xp.concat((0.0 * v_pu[..., :1], loading), axis=-1)


def _three_phase_loading(feeder: ThreePhaseFeeder, solution: ThreePhaseSolution) -> Array:
    """Of the rated nodes alone, which may be few, put among zeros."""
    v_pu = solution.v_pu
    xp = namespace(v_pu)
    rated, regulated, before, place = rated_places(feeder, xp, v_pu.device)
    i_re, i_im = take_last(solution.i_re_a, rated), take_last(solution.i_im_a, rated)
    loading = positive_sqrt(i_re * i_re + i_im * i_im) * as_like(inverse_ratings(feeder), v_pu)[rated]
    n_unregulated = len(rated) - len(regulated)
    parts = [loading[..., :n_unregulated], 0.0 * v_pu[..., :1]]
    if len(regulated):
        ratio = take_last(v_pu, regulated) / (take_last(v_pu, before) + NO_VOLTAGE_PU)
        parts.insert(1, loading[..., n_unregulated:] * (1.0 + positive_part(ratio - 1.0)))
    return take_last(xp.concat(parts, axis=-1), place)


@cached_on_owner
def rated_places(feeder: ThreePhaseFeeder, xp: ModuleType, device: object) -> tuple[Array, ...]:
    """Rated nodes, the regulated ones last; these, and the nodes before them; the place of each node in that order.

    A node without a rating has the place behind all of them.
    """
    rated = rated_nodes(feeder)
    regulated = rated[np.isin(rated, feeder.regulated)]
    rated = np.concatenate((np.setdiff1d(rated, regulated), regulated))
    place = np.full(feeder.n_node, len(rated))
    place[rated] = np.arange(len(rated))
    places = (rated, regulated, feeder.node_parent[regulated], place)
    return places if xp is np else tuple(xp.asarray(np.array(p, np.int64), device=device) for p in places)


class _Flows(NamedTuple):
    """What is taken of a solution."""

    v_pu: Array
    p_branch_kw: Array
    q_branch_kvar: Array


@cached_on_owner
def _ratings_a(feeder: AnyFeeder) -> NDArray[np.float64]:
    """Rating of what has each position in the loading, A, NaN where it is not known."""
    if isinstance(feeder, Feeder):
        return np.concatenate(
            ([np.nan], np.full(feeder.n_branch, np.nan) if feeder.rating_a is None else feeder.rating_a)
        )
    return np.full(feeder.n_node, np.nan) if feeder.rating_a is None else feeder.rating_a


@cached_on_owner
def inverse_ratings(feeder: AnyFeeder) -> NDArray[np.float64]:
    """1 / rating of what has each position in the loading, 1/A, 0 where it is not known."""
    ratings = _ratings_a(feeder)
    return np.where(np.isnan(ratings), 0.0, 1.0 / ratings)


@cached_on_owner
def _parents(feeder: Feeder, xp: ModuleType, device: object) -> Array:
    """Sending end of each branch as an index of the array's kind."""
    return feeder.from_bus if xp is np else xp.asarray(np.array(feeder.from_bus, np.int64), device=device)
