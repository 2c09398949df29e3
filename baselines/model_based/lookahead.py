"""The program of a controller that looks ahead on a linear model, and a batched solver for it.

    minimise  sum_k [ w_v mean|e_k| + w_o mean max(|e_k| - band, 0) + w_q mean |q_k| / s_rated + sum_i price_k,i b_k,i ]
    over      d_k  work served by each site, q_k  reactive injection of each agent, k = 1..H
    with      e_k = offset_k + slopes (d_k, q_k)                        deviation of every bus's voltage
              b_k = work_k - sum_{j <= k} d_j >= 0                      what waits; nothing is served before it arrives
              low <= d <= high,  |q| <= q_high,  (base_k + d)^2 + q^2 <= s_rated^2

the benchmark's own cost (see ``engine.cost.reward``). If the cost has a voltage profile, the first term is w_v mean
max(|e_k - target| - uncharged, 0). Entries of e that are limits cost a price times max(e_k, 0) instead. Powers are
shares of a device's own size throughout. It is solved for all rows at once by ADMM (S. Boyd, N. Parikh, E. Chu, B.
Peleato, J. Eckstein, "Distributed optimization and statistical learning via the alternating direction method of
multipliers", 2011), split as

    e = offset + slopes x,   y = x,   b = work - cumulated d

so each part has a solution in closed form: soft thresholds at the kinks of a bus's cost, the projection on box and
circle, and one least-squares problem. The eigenvectors of the time axis split its inverse into one of the size of a
single step for each. On states of validation episodes 100 rounds from the last second's solution moved on by a step
leave the objective 0.04 % above the optimum of HiGHS on average, 0.35 % at most (12 steps of ieee33-weak; less on
ieee123 and toy6). The number of rounds is fixed, so the solution of a row does not depend on the other rows.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

_FAR = 1e9  # beyond all deviations
RELAXATION = 1.6
"""Over-relaxation of ADMM (Boyd et al., section 3.4.3)."""


class Program(NamedTuple):
    """A batch of programs; L rows, H steps, m buses, n_dc sites, n_agent agents, x = (d, q) of n = n_dc + n_agent."""

    offset: np.ndarray
    """Deviation from 1 p.u. at x = 0, (L, H, m)."""
    slopes: np.ndarray
    """Change of the voltages by x, (L, n, m)."""
    base: np.ndarray
    """Draw of the sites below the work served, (L, H, n_dc)."""
    low: np.ndarray
    """Least and largest work served, (L, H, n_dc)."""
    high: np.ndarray
    s_rated: np.ndarray
    """Apparent-power rating of the sites, (L, H, n_dc)."""
    q_high: np.ndarray
    """Largest reactive magnitude apart from the circle, (L, n_agent)."""
    work: np.ndarray
    """Work that has come until the end of each step, what waited before included, (L, H, n_dc)."""
    price: np.ndarray
    """Price of what waits at the end of each step, (H, n_dc)."""
    voltage: float
    """Weights of a bus's deviation and of its excess over the band."""
    violation: float
    effort: np.ndarray
    """Weight of an agent's reactive magnitude, (n_agent,)."""
    band_pu: float
    target: np.ndarray | None = None
    """Target of each bus less 1 p.u., (m,), which the deviation is charged from; None for 0."""
    uncharged_pu: float = 0.0
    """Half the width of the band around the targets in which no deviation is charged."""
    n_limits: int = 0
    """Number of limits: the last entries m of ``offset`` and ``slopes`` cost only what they are above 0."""
    beyond_limit: float = 0.0
    """Price of what is above 0 there."""


class Iterate(NamedTuple):
    """Where the solver stands: the three parts and their scaled multipliers."""

    e: np.ndarray
    y: np.ndarray
    b: np.ndarray
    u_e: np.ndarray
    u_y: np.ndarray
    u_b: np.ndarray


class Penalties(NamedTuple):
    """Weights of ADMM's splits, relative to the program's own size; a larger one holds its sides together more
    tightly."""

    e: float
    y: float
    b: float


PENALTIES = Penalties(200.0, 0.3, 1.0)
"""Chosen on such states: 60 rounds from cold leave 0.09 % over 8 steps of ieee33-weak on average, 0.16 % with half the
first, 1.5 % with five times the first and three times the last."""


def solve(program: Program, start: Iterate | None, rounds: int) -> Iterate:
    """Go on from ``start``, or from serving work as it comes without reactive power, for a number of rounds.

    ``y`` of the result, (L, H, n), is within all limits of the devices. From the second step on it may serve a little
    work that has not arrived, until the rounds have converged.
    """
    # Both bring the compiler with them, so not on import.
    from dcgrid_env.baselines.model_based import lookahead_kernels
    from dcgrid_env.core.threads import over_rows

    kernel: Any = lookahead_kernels.rounds
    p, system = program, _system(program)
    iterate = _begin(program) if start is None else start
    done = Iterate(*(np.array(part, dtype=np.float64, order="C") for part in iterate))
    n_dc = p.base.shape[-1]
    data = [
        np.ascontiguousarray(values, dtype=np.float64)
        for values in (
            p.offset, p.slopes, p.base, p.low, p.high, p.s_rated, p.q_high, p.work, p.price / system.w_b[:, None],
            p.effort / system.w_y[:, n_dc:],
        )
    ]  # fmt: skip
    matrices = [
        np.ascontiguousarray(values)
        for values in (system.w_y, system.w_b, system.over_time, system.inverse, system.sites, system.share)
    ]
    by, by_more = p.voltage / system.w_e, p.violation / system.w_e
    kinks = _kinks(p, by, by_more, p.beyond_limit / system.w_e)

    def part(first: int, last: int) -> int:
        return kernel(
            first, last, rounds, RELAXATION, p.band_pu, by, by_more, *kinks, *data, system.w_e, *matrices, *done
        )  # fmt: skip

    over_rows(part, len(p.offset))
    return done


def _kinks(p: Program, by: float, by_more: float, beyond: float) -> tuple[np.ndarray, np.ndarray]:
    """Kinks of the cost of each bus's deviation in their order, and the rise of its slope there, (m, 4) each.

    Without targets and limits, (0, 4) each: the kernel knows that cost.
    """
    if p.target is None and not p.n_limits:
        return np.empty((0, 4)), np.empty((0, 4))
    m = p.offset.shape[-1] - p.n_limits
    target, edge = np.zeros(m) if p.target is None else p.target, np.full(m, p.band_pu)
    kinks = np.stack((target - p.uncharged_pu, target + p.uncharged_pu, -edge, edge), axis=1)
    order = np.argsort(kinks, axis=1)
    # The kernel begins at the steepest fall of a voltage's cost, which a limit's ends at once.
    kinks, rises = np.take_along_axis(kinks, order, axis=1), np.array([by, by, by_more, by_more])[order]
    of_limits = np.tile([-_FAR, 0.0, _FAR, _FAR], (p.n_limits, 1))
    rises_there = np.tile([by + by_more, beyond, 0.0, 0.0], (p.n_limits, 1))
    return np.concatenate((kinks, of_limits)), np.concatenate((rises, rises_there))


def moved_on(iterate: Iterate) -> Iterate:
    """The iterate one step later; the last step stays as it was."""
    return Iterate(*(np.concatenate((part[:, 1:], part[:, -1:]), axis=1) for part in iterate))


def restarted(program: Program, iterate: Iterate) -> Iterate:
    """The iterate with the limits of another program: they begin from what it has, and without a multiplier."""
    if not program.n_limits:
        return iterate
    e, u_e, last = iterate.e.copy(), iterate.u_e.copy(), slice(-program.n_limits, None)
    e[..., last] = program.offset[..., last] + np.matmul(iterate.y, program.slopes[..., last])
    u_e[..., last] = np.where(e[..., last] < 0.0, 0.0, u_e[..., last])
    return iterate._replace(e=e, u_e=u_e)


def _begin(program: Program) -> Iterate:
    """All work served as it comes, as far as may be, and no reactive power."""
    p = program
    d = np.clip(np.diff(p.work, axis=1, prepend=0.0), p.low, p.high)
    y = np.concatenate((d, np.zeros((*d.shape[:2], p.q_high.shape[-1]))), axis=-1)
    e = p.offset + np.matmul(y, p.slopes)
    b = np.maximum(p.work - np.cumsum(d, axis=1), 0.0)
    return Iterate(e, y, b, 0.0 * e, 0.0 * y, 0.0 * b)


class _System(NamedTuple):
    """ADMM's least-squares problem of a batch, ready to be solved.

    With C the cumulated sum over time, C'C = U diag(g) U', and E the sites' part of x, the matrix of mode k is
    M + g_k E diag(w_b) E', M = w_e S S' + diag(w_y). With w_b^(1/2) E' M^-1 E w_b^(1/2) = V diag(c) V' and
    W = M^-1 E w_b^(1/2) V its inverse is M^-1 - W diag(g_k / (1 + g_k c)) W' (Woodbury).
    """

    w_e: float
    """Penalties: of e, of y (L, n), of b (L, n_dc)."""
    w_y: np.ndarray
    w_b: np.ndarray
    over_time: np.ndarray
    """U, (H, H)."""
    inverse: np.ndarray
    """M^-1, (L, n, n)."""
    sites: np.ndarray
    """W, (L, n, n_dc)."""
    share: np.ndarray
    """g_k / (1 + g_k c), (L, H, n_dc)."""


def _system(program: Program) -> _System:
    p, steps, n_dc = program, program.offset.shape[1], program.base.shape[-1]
    w_e = PENALTIES.e * (max(p.voltage, 0.01 * p.violation) or 1.0)
    squares = np.matmul(p.slopes, p.slopes.swapaxes(1, 2))
    i, n = np.arange(squares.shape[-1]), squares.shape[-1]
    size = np.maximum(squares[:, i, i], 1e-9)
    # p and q of a site have one penalty, so that the projection on the circle is one.
    size[:, :n_dc] = size[:, n_dc : 2 * n_dc] = np.maximum(size[:, :n_dc], size[:, n_dc : 2 * n_dc])
    w_y, w_b = PENALTIES.y * w_e * size, PENALTIES.b * w_e * size[:, :n_dc]
    matrix = w_e * squares
    matrix[:, i, i] += w_y
    inverse = np.linalg.inv(matrix)
    root = np.sqrt(w_b)
    curvature, vectors = np.linalg.eigh(root[:, :, None] * inverse[:, :n_dc, :n_dc] * root[:, None])
    summed = np.tril(np.ones((steps, steps)))
    growth, over_time = np.linalg.eigh(summed.T @ summed)
    share = growth[:, None] / (1.0 + growth[:, None] * curvature[:, None])
    sites = np.matmul(inverse[:, :, :n_dc] * root[:, None], vectors) if n_dc else np.zeros((len(size), n, 0))
    return _System(w_e, w_y, w_b, over_time, inverse, sites, share)
