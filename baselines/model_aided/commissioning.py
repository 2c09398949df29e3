"""What an agent works out once from the feeder's model, all agents' places and ratings, and the statistics of the load.

Moments of the operation (``operating_points``) are solved by the exact power flow with all agents at their static
optimum u* (with a schedule of the sun: at six levels of it). Then the agents respond to what each sees, some rounds of
``best_response`` at every moment, so that what others do about a deviation is in the statistics too. What remains of
the voltages V_k once agent i's own draw and setpoint are taken out,

    E_k = V_k - X_ik (q_i - u*_i) + D_ik (p_i - mean p_i)          D: own drop, and that of sites that draw as it draws

is regressed on what the agent can know of it, E_i at its own bus: around a level of the sun that an inverter reads from
its own injection, and the others from E_i,

    E[E_k | E_i] = base_k + g_ik (E_i - base_i)      g_ik = C_ki / (C_ii + noise)      s_ik^2 = C_kk - C_ki^2 / C_ii

with C the covariance over the moments of that level: the estimate of a jointly normal variable from another, with its
error (for instance S. M. Kay, "Fundamentals of statistical signal processing: estimation theory", 1993, chapter 12).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dcgrid_env import Scenario, nodes_by_bus, sensitivity_to_agents, solver_for
from dcgrid_env.baselines.model_aided.best_response import best_response
from dcgrid_env.baselines.model_aided.expected_cost import VoltagePrice
from dcgrid_env.baselines.model_aided.operating_points import OperatingPoints
from dcgrid_env.baselines.model_aided.static_optimum import static_optimum

SUN_LEVELS = 6
_MOMENTS_OF_OPTIMUM = 12
_ROUNDS = 6
_CAUTIOUS_ROUNDS = 3  # of these the first, of which each goes only a part of the way
_PART = 0.6
_CORRELATED = 4.0  # sites count as correlated where their correlation is beyond so many standard errors of chance


class Law(NamedTuple):
    """Settings of the law that commissioning needs too."""

    floor_pu: float
    alike: float
    hold: float
    pull: float


class Commissioned(NamedTuple):
    """An agent's knowledge of a placement; n agents, L levels, k nodes but the source's. Stacked over lanes in use."""

    mean_kw: np.ndarray
    """Mean draw, (n,)."""
    rest_kvar: np.ndarray
    """u* at each level of the sun, (L, n); one level without a schedule."""
    rest_at: np.ndarray
    """Mean of these levels, draw of an inverter as a share of its rating (negative), rising, (L,)."""
    origin_kvar: np.ndarray
    """The setpoint that deviations are counted from, (n,)."""
    by_q: np.ndarray
    """X: rise of each voltage by own injection, p.u. per kvar, (n, k)."""
    by_p: np.ndarray
    """R: drop of each voltage by own draw, p.u. per kW, (n, k)."""
    by_draw: np.ndarray
    """D: drop that comes with each kW drawn, p.u. per kW, (n, k)."""
    own_by_q: np.ndarray
    """X at the own bus, (n,)."""
    own_by_draw: np.ndarray
    """D at the own bus, (n,)."""
    key: np.ndarray
    """What a level is known by: own draw of an inverter under a schedule, kW, else E_i, p.u., rising, (n, L)."""
    base_pu: np.ndarray
    """(n, L, k)"""
    own_base_pu: np.ndarray
    """(n, L)"""
    gain: np.ndarray
    """g, (n, L, k)."""
    spread_pu: np.ndarray
    """s, (n, L, k)."""
    by_all: np.ndarray
    """Rise of each voltage when all agents inject their whole limit more, p.u., (n, L, k)."""


class Site(NamedTuple):
    """What is the same in all placements of a scenario."""

    scenario: Scenario
    points: OperatingPoints
    q_scale_kvar: np.ndarray
    s_rated_kva: np.ndarray
    effort: np.ndarray
    """Price of a whole limit of reactive power, (n,)."""
    law: Law

    @property
    def scheduled(self) -> np.ndarray:
        """Which agents read the sun from their own injection, bool, (n,)."""
        at = np.arange(self.scenario.n_agents)
        return (at >= self.scenario.n_datacenters) & (self.scenario.schedule is not None)

    def limit_share(self, p_kw: np.ndarray) -> np.ndarray:
        """Reactive limit at a draw as a share of that at zero active power, (m, n)."""
        room = np.sqrt(np.maximum(self.s_rated_kva**2 - p_kw**2, 0.0))
        return np.minimum(self.q_scale_kvar, room) / self.share_of_kvar

    @property
    def share_of_kvar(self) -> np.ndarray:
        """The limit, 1 where there is none, (n,)."""
        return np.where(self.q_scale_kvar > 0.0, self.q_scale_kvar, 1.0)


def commission(site: Site, buses: np.ndarray) -> Commissioned:
    """Work out what the agents know at positions ``buses`` of ``bus_ids``, (n_agent,).

    Voltages of moments without a solution, as under an extreme load, are left out.
    """
    s, points = site.scenario, site.points
    n_dc, nodes_of_load = s.n_datacenters, s.feeder.load_slice
    by_p, by_q = (slope[0][:, nodes_of_load] / 1000.0 for slope in sensitivity_to_agents(s, buses[None]))
    levels = _levels(site)
    flow = _Flow(s, points, buses)
    scale, draw = site.share_of_kvar, points.p_agent_kw
    limit = site.limit_share(draw)
    rng = np.random.default_rng(1)
    rest = []
    for rows in levels:
        drawn = rng.choice(rows, min(_MOMENTS_OF_OPTIMUM, len(rows)), replace=False)
        mean_limit = limit[rows].mean(axis=0) * scale
        own = flow.of(drawn)
        rest.append(static_optimum(s, own, by_q, site.q_scale_kvar, mean_limit, site.effort))
    rest_kvar = np.array(rest)
    rest_at = np.array([-points.sun[rows].mean() for rows in levels]) / (s.scheduled_kva.sum() or 1.0)
    order = np.argsort(rest_at, kind="stable")
    rest_kvar, rest_at, mean_kw = rest_kvar[order], rest_at[order], draw.mean(axis=0)
    origin = rest_kvar.mean(axis=0)
    rest_all = resting(site, rest_at, rest_kvar, draw)
    v = flow.at(rest_all)
    by_q, by_p = by_q / v.mean(axis=0), by_p / v.mean(axis=0)
    v = v - (rest_all - origin) @ by_q  # at the origin, by the model
    by_draw = by_p.copy()
    by_draw[:n_dc] += _correlated(draw[:, :n_dc]) @ by_p[:n_dc]
    seen = flow.seen
    known = Commissioned(
        mean_kw, rest_kvar, rest_at, origin, by_q, by_p, by_draw,
        (by_q * seen).sum(axis=1), (by_draw * seen).sum(axis=1), *[np.empty(0)] * 6,
    )  # fmt: skip
    moved = rest_all - origin
    known = _regressed(site, known, v, moved, seen)
    price = VoltagePrice.of(s)
    for k in range(_ROUNDS):
        e_own = (v + moved @ by_q) @ seen.T - moved * known.own_by_q + (draw - mean_kw) * known.own_by_draw
        v_known, s_known, by_all = estimate(site, known, e_own, draw)
        v_known = v_known + by_q * moved[..., None] - by_draw * (draw - mean_kw)[..., None]
        share = (origin + moved) / scale
        best = best_response(
            price, v_known, s_known, site.law.alike * by_all, by_q * site.q_scale_kvar[:, None], share, limit,
            site.effort, site.law.hold, rest_all / scale, halvings=7,
        )  # fmt: skip
        share = share + (_PART if k < _CAUTIOUS_ROUNDS else 1.0) * (best - share)
        share = share + site.law.pull * site.scheduled * (rest_all / scale - share)
        moved = np.clip(share, -limit, limit) * scale - origin
        known = _regressed(site, known, v, moved, seen)
    return known


def resting(site: Site, rest_at: np.ndarray, rest_kvar: np.ndarray, p_kw: np.ndarray) -> np.ndarray:
    """u* as an agent has it at its draw, kvar, (m, n): of the sun that an inverter reads off, else the levels' mean."""
    lanes = np.broadcast_to(rest_kvar, (*p_kw.shape[:1], *rest_kvar.shape[-2:]))
    at = np.broadcast_to(rest_at, (*p_kw.shape[:1], rest_at.shape[-1]))
    out = lanes.mean(axis=1)
    kva = site.scenario.scheduled_kva
    for j in np.flatnonzero(site.scheduled):
        share = p_kw[:, j] / (kva[j - site.scenario.n_datacenters] or 1.0)
        low, weight = between(share[:, None], at[:, None])
        rows = np.arange(len(p_kw))
        a, b = (lanes[rows, low[:, 0] + more, j] for more in (0, 1))
        out[:, j] = a + weight[:, 0] * (b - a)
    return out


def estimate(site: Site, known: Commissioned, e_own: np.ndarray, p_kw: np.ndarray) -> tuple[np.ndarray, ...]:
    """E[E_k | E_i], its standard deviation, and ``by_all``, each (m, n, k), for what the agents know, (m, n) each.

    ``known`` is of one placement, or has a leading lane.
    """
    key = known.key if known.key.ndim == 3 else known.key[None]
    fields = (known.base_pu, known.own_base_pu, known.gain, known.spread_pu, known.by_all)
    base, own, gain, spread, by_all = (a if known.key.ndim == 3 else a[None] for a in fields)
    if key.shape[-1] == 1:
        e = base[:, :, 0] + gain[:, :, 0] * (e_own - own[:, :, 0])[..., None]
        return e, *(np.broadcast_to(a[:, :, 0], e.shape) for a in (spread, by_all))
    low, weight = between(np.where(site.scheduled, p_kw, e_own), key)
    lane = np.arange(len(key))[:, None] if len(key) == len(e_own) else np.zeros((1, 1), int)
    agent = np.arange(e_own.shape[1])
    total: list[np.ndarray] = []
    for at, share in ((low, 1.0 - weight), (low + 1, weight)):
        e = base[lane, agent, at] + gain[lane, agent, at] * (e_own - own[lane, agent, at])[..., None]
        parts = [share[..., None] * a for a in (e, spread[lane, agent, at], by_all[lane, agent, at])]
        total = parts if not total else [a + b for a, b in zip(total, parts, strict=True)]
    return tuple(total)


def between(value: np.ndarray, knots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The knot below a value, and how far it is on the way to the next, 0 to 1, held at the ends; knots (.., L)."""
    n = knots.shape[-1]
    if n == 1:
        return np.zeros(value.shape, int), np.zeros(value.shape)
    low = (value[..., None] >= knots[..., 1:-1]).sum(axis=-1)
    wide = np.broadcast_to(knots, (*value.shape, n))
    a, b = (np.take_along_axis(wide, (low + more)[..., None], -1)[..., 0] for more in (0, 1))
    return low, np.clip((value - a) / np.maximum(b - a, 1e-12), 0.0, 1.0)


class _Flow:
    """The exact power flow of the moments, for one placement."""

    def __init__(self, scenario: Scenario, points: OperatingPoints, buses: np.ndarray) -> None:
        s, feeder = scenario, scenario.feeder
        self.scenario, self.points = s, points
        nodes = nodes_by_bus(s)[np.arange(s.n_agents), buses]
        self.shares = np.zeros((s.n_agents, feeder.n_leg))
        rows = np.arange(s.n_agents)[:, None]
        np.add.at(self.shares, (rows, feeder.first_device_leg + nodes), 1.0 / nodes.shape[1])
        seen = np.zeros((s.n_agents, feeder.n_node))
        np.add.at(seen, (rows, nodes), 1.0 / nodes.shape[1])
        self.seen = seen[:, feeder.load_slice]
        """Share of each voltage in what an agent sees, (n_agent, k)."""

    def of(self, rows: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Voltages of some moments as a function of constant setpoints, kvar, (n_agent,)."""
        return lambda q_kvar: self.at(np.broadcast_to(q_kvar, (len(rows), len(q_kvar))), rows)

    def at(self, q_kvar: np.ndarray, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Voltages of moments under setpoints, (m, n_agent), p.u., (m, k); the mean where there is no solution."""
        s, points = self.scenario, self.points
        p = points.p_load_kw[rows] + points.p_agent_kw[rows] @ self.shares
        q = points.q_load_kvar[rows] - q_kvar @ self.shares
        solution = solver_for(s.feeder, s.power_flow)(s.feeder, p, q, s.source_voltage_pu)
        v = np.asarray(solution.v_pu)[:, s.feeder.load_slice]
        solved = np.asarray(solution.converged)
        if not solved.any():
            raise ValueError(
                f"model-aided: the power flow of scenario {s.name!r} has no solution at any of its moments; give the "
                "feeder less load"
            )
        return np.where(solved[:, None], v, v[solved].mean(axis=0))


def _levels(site: Site) -> list[np.ndarray]:
    """Rows of the moments of each level of the sun; all in one without a schedule."""
    rows = np.argsort(site.points.sun, kind="stable")
    return np.array_split(rows, SUN_LEVELS if site.scenario.schedule is not None else 1)


def _correlated(draw_kw: np.ndarray) -> np.ndarray:
    """How much each other site draws with each kW of a site, (n_dc, n_dc), 0 where that may be chance."""
    m, n = draw_kw.shape
    apart = draw_kw - draw_kw.mean(axis=0)
    covariance = apart.T @ apart / m
    variance = np.maximum(np.diag(covariance), 1e-12)
    correlation = covariance / np.sqrt(np.outer(variance, variance))
    moves = np.where(np.abs(correlation) > _CORRELATED / np.sqrt(m), covariance / variance[:, None], 0.0)
    return moves * (1.0 - np.eye(n))


def _regressed(site: Site, known: Commissioned, v: np.ndarray, moved: np.ndarray, seen: np.ndarray) -> Commissioned:
    """``known`` with what the moments tell each agent, under setpoints moved from the origin, kvar, (m, n)."""
    s, draw, law = site.scenario, site.points.p_agent_kw, site.law
    n, n_level = s.n_agents, len(known.rest_at)
    there = v + moved @ known.by_q
    limit_kvar = site.limit_share(draw) * site.q_scale_kvar
    key, own_base = np.zeros((2, n, n_level))
    base, gain, spread, by_all = np.zeros((4, n, n_level, v.shape[1]))
    noise = s.voltage_noise_pu**2 + (0.1 * law.floor_pu) ** 2
    for i in range(n):
        e = there - moved[:, i : i + 1] * known.by_q[i] + (draw[:, i : i + 1] - known.mean_kw[i]) * known.by_draw[i]
        own = e @ seen[i]
        level_of = draw[:, i] if site.scheduled[i] else own
        for level, rows in enumerate(np.array_split(np.argsort(level_of, kind="stable"), n_level)):
            mean = e[rows].mean(axis=0)
            apart = e[rows] - mean
            apart_own = apart @ seen[i]
            together = (apart * apart_own[:, None]).mean(axis=0)
            variance = (apart_own * apart_own).mean() + noise
            rest = (apart * apart).mean(axis=0) - together * together / variance
            key[i, level], own_base[i, level] = level_of[rows].mean(), own[rows].mean()
            base[i, level], gain[i, level] = mean, together / variance
            spread[i, level] = np.sqrt(np.maximum(rest, 0.0) + law.floor_pu**2)
            by_all[i, level] = limit_kvar[rows].mean(axis=0) @ known.by_q
    return known._replace(key=key, base_pu=base, own_base_pu=own_base, gain=gain, spread_pu=spread, by_all=by_all)
