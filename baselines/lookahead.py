"""The program of a controller that looks ahead on a linear model, and a batched solver for it.

    minimise  sum_k [ w_v mean|e_k| + w_o mean max(|e_k| - band, 0) + w_q mean |q_k| / s_rated + sum_i price_k,i b_k,i ]
    over      d_k  work served by each site, q_k  reactive injection of each agent, k = 1..H
    with      e_k = offset_k + slopes (d_k, q_k)                        deviation of every bus's voltage
              b_k = work_k - sum_{j <= k} d_j >= 0                      what waits; nothing is served before it arrives
              low <= d <= high,  |q| <= q_high,  (base_k + d)^2 + q^2 <= s_rated^2

the benchmark's own cost (see ``dcgrid_env.reward``). Powers are shares of a device's own size throughout. It is solved
for all lanes at once by ADMM (S. Boyd, N. Parikh, E. Chu, B. Peleato, J. Eckstein, "Distributed optimization and
statistical learning via the alternating direction method of multipliers", 2011), split as

    e = offset + slopes x,   y = x,   b = work - cumulated d

so that each part has a solution in closed form: soft thresholds at 0 and at the band, the projection on box and circle,
and one least-squares problem, whose inverse the eigenvectors of the time axis split into one of the size of a single
step for each. Started from the last second's solution moved on by a step, some ten rounds are enough. The number of
rounds is fixed, so that a lane's solution is the same whatever stands beside it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

RELAXATION = 1.6
"""Over-relaxation of ADMM (Boyd et al., section 3.4.3)."""


class Program(NamedTuple):
    """A batch of programs; L lanes, H steps, m buses, n_dc sites, n_agent agents, x = (d, q) of n = n_dc + n_agent."""

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
    """Apparent-power rating of the sites, (n_dc,)."""
    q_high: np.ndarray
    """Largest reactive magnitude beside the circle, (L, n_agent)."""
    work: np.ndarray
    """Work that has come until the end of each step, what waited before included, (L, H, n_dc)."""
    price: np.ndarray
    """Of what waits at the end of each step, (H, n_dc)."""
    voltage: float
    """Weights of a bus's deviation and of its excess over the band."""
    violation: float
    effort: np.ndarray
    """Weight of an agent's reactive magnitude, (n_agent,)."""
    band_pu: float


class Iterate(NamedTuple):
    """Where the solver stands: the three parts and their scaled multipliers."""

    e: np.ndarray
    y: np.ndarray
    b: np.ndarray
    u_e: np.ndarray
    u_y: np.ndarray
    u_b: np.ndarray


def cost(program: Program, x: np.ndarray) -> np.ndarray:
    """Objective (L,) of x, (L, H, n), inside its limits; more served than there is counts as what there is."""
    n_dc = program.base.shape[-1]
    served, there = [], program.work[:, 0]
    coming = np.diff(program.work, axis=1)
    for k in range(x.shape[1]):
        served.append(np.minimum(x[:, k, :n_dc], there))
        there = there - served[-1] + (coming[:, k] if k < coming.shape[1] else 0.0)
    d = np.stack(served, axis=1)
    q = x[..., n_dc:]
    e = np.abs(program.offset + np.matmul(np.concatenate((d, q), axis=-1), program.slopes))
    waits = program.work - np.cumsum(d, axis=1)
    return (
        program.voltage * e.sum(axis=(1, 2))
        + program.violation * np.maximum(e - program.band_pu, 0.0).sum(axis=(1, 2))
        + (np.abs(q) * program.effort).sum(axis=(1, 2))
        + (program.price * waits).sum(axis=(1, 2))
    )


class Steps(NamedTuple):
    """Penalties of ADMM: weight of each split; larger holds its two sides together more tightly."""

    e: float
    y: float
    b: float


STEPS = Steps(200.0, 0.3, 1.0)


def solve(program: Program, start: Iterate | None, rounds: int, steps: Steps = STEPS) -> Iterate:
    """Go on from ``start``, or from serving all work at once without reactive power, for a number of rounds.

    ``y`` of the result is (L, H, n), within all limits of the devices; work not there yet may be served from the second
    step on until the rounds have settled that.
    """
    p, n_dc = program, program.base.shape[-1]
    rho_e = steps.e * p.voltage
    size = (p.slopes**2).sum(axis=-1)
    size[:, :n_dc] = size[:, n_dc : 2 * n_dc] = np.maximum(size[:, :n_dc], size[:, n_dc : 2 * n_dc])
    rho_y = steps.y * rho_e * size  # (L, n)
    rho_b = steps.b * rho_e * size[:, :n_dc]
    over_time, inverse = _inverse(p, rho_e, rho_y, rho_b)
    at = _begin(p) if start is None else start
    slopes_t = np.ascontiguousarray(p.slopes.swapaxes(1, 2))
    e, y, b, u_e, u_y, u_b = at
    w_e, w_y, w_b = rho_e, rho_y[:, None], rho_b[:, None]
    effort, price = p.effort / w_y[..., n_dc:], p.price / w_b
    for _ in range(rounds):
        right = np.matmul(w_e * (e - u_e - p.offset), slopes_t) + w_y * (y - u_y)
        right[..., :n_dc] += np.flip(np.cumsum(np.flip(w_b * (p.work - b + u_b), 1), axis=1), 1)
        modes = np.matmul(over_time.T, right)
        x = np.matmul(over_time, np.matmul(inverse, modes[..., None])[..., 0])
        ex = RELAXATION * (np.matmul(x, p.slopes) + p.offset) + (1.0 - RELAXATION) * e
        yx = RELAXATION * x + (1.0 - RELAXATION) * y
        bx = RELAXATION * (p.work - np.cumsum(x[..., :n_dc], axis=1)) + (1.0 - RELAXATION) * b
        e = _shrink(ex + u_e, p.voltage / w_e, p.violation / w_e, p.band_pu)
        y = _within(p, yx + u_y, effort)
        b = np.maximum(bx + u_b - price, 0.0)
        u_e = u_e + ex - e
        u_y = u_y + yx - y
        u_b = u_b + bx - b
    return Iterate(e, y, b, u_e, u_y, u_b)


def moved_on(at: Iterate) -> Iterate:
    """The same one step later; the last step stays as it was."""
    return Iterate(*(np.concatenate((part[:, 1:], part[:, -1:]), axis=1) for part in at))


def _begin(program: Program) -> Iterate:
    """All work served as it comes, as far as may be, and no reactive power."""
    p = program
    d = np.clip(np.diff(p.work, axis=1, prepend=0.0), p.low, p.high)
    y = np.concatenate((d, np.zeros((*d.shape[:2], p.q_high.shape[-1]))), axis=-1)
    e = p.offset + np.matmul(y, p.slopes)
    b = np.maximum(p.work - np.cumsum(d, axis=1), 0.0)
    return Iterate(e, y, b, 0.0 * e, 0.0 * y, 0.0 * b)


def _inverse(program: Program, rho_e: float, rho_y: np.ndarray, rho_b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvectors (H, H) of the cumulated sum's square over time, and the inverse for each, (L, H, n, n)."""
    steps, n, n_dc = program.offset.shape[1], rho_y.shape[-1], rho_b.shape[-1]
    summed = np.tril(np.ones((steps, steps)))
    values, vectors = np.linalg.eigh(summed.T @ summed)
    matrix = np.repeat(rho_e * np.matmul(program.slopes, program.slopes.swapaxes(1, 2))[:, None], steps, axis=1)
    i, d = np.arange(n), np.arange(n_dc)
    matrix[..., i, i] += rho_y[:, None]
    matrix[..., d, d] += values[:, None] * rho_b[:, None]
    return vectors, np.linalg.inv(matrix)


def _shrink(value: np.ndarray, by: float, by_more: float, band: float) -> np.ndarray:
    """Proximal point of by |e| + by_more max(|e| - band, 0)."""
    size = np.maximum(np.abs(value) - by, 0.0)
    return np.copysign(np.minimum(size, np.maximum(band, size - by_more)), value)


def _within(program: Program, x: np.ndarray, effort: np.ndarray) -> np.ndarray:
    """Proximal point of effort |q| within box and circle."""
    p, n_dc = program, program.base.shape[-1]
    d, q = np.clip(x[..., :n_dc], p.low, p.high), x[..., n_dc:]
    size = np.minimum(np.maximum(np.abs(q) - effort, 0.0), p.q_high[:, None])
    # A corner of the box that the circle cuts off: the nearest point is on the arc, or where the box ends it. What is
    # outside box and circle but nearest to a side of the box has been put there.
    own, s = size[..., :n_dc], p.s_rated
    real = p.base + d
    if (real * real + own * own > s * s).any():
        p_out = p.base + x[..., :n_dc]
        q_out = np.maximum(np.abs(q[..., :n_dc]) - effort[..., :n_dc], 0.0)
        radius = np.maximum(np.hypot(p_out, q_out), 1e-12)
        q_top = p.q_high[:, None, :n_dc]
        p_arc = np.clip(p_out * s / radius, np.sqrt(np.maximum(s * s - q_top * q_top, 0.0)), s)
        p_arc = np.clip(p_arc, p.base + p.low, p.base + p.high)
        q_arc = np.minimum(np.sqrt(np.maximum(s * s - p_arc * p_arc, 0.0)), q_top)
        cut = real * real + own * own > s * s
        d = np.where(cut, p_arc - p.base, d)
        size[..., :n_dc] = np.where(cut, q_arc, own)
    return np.concatenate((d, np.copysign(size, q)), axis=-1)
