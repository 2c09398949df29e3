"""What an agent works out once from the feeder's model, all agents' places and ratings, and the statistics of the load.

Moments of the operation (``operating_points``) are solved by the exact power flow with all agents at their static
optimum u*. With a schedule of the sun there are six levels of it. A regression gives each agent's estimate of all
voltages from its own (``regression``). Then the agents respond to what each sees, some rounds of ``decision`` at every
moment. So the statistics include the others' reactions to a deviation and their answers to an agent's action
(``answers``). At last each agent finds how far to move at once (``damping``).
"""

from __future__ import annotations

import numpy as np

from dcgrid_env import Scenario, sensitivity_to_agents
from dcgrid_env.baselines.controller import require_known_devices, require_work_draws
from dcgrid_env.baselines.model_aided.answers import answered, slopes
from dcgrid_env.baselines.model_aided.average import newest_weight
from dcgrid_env.baselines.model_aided.damping import settled
from dcgrid_env.baselines.model_aided.decision import DecisionInputs, decide
from dcgrid_env.baselines.model_aided.knowledge import Commissioned, Law, Site, by_sun
from dcgrid_env.baselines.model_aided.moment_flow import MomentFlow
from dcgrid_env.baselines.model_aided.operating_points import OperatingPoints, operating_points
from dcgrid_env.baselines.model_aided.regression import regressed
from dcgrid_env.baselines.model_aided.static_optimum import static_optimum

MOMENTS = 240
"""Moments of the operation that statistics are over; twice as many where levels of the sun divide them."""
SUN_LEVELS = 6
_OPTIMUM_MOMENTS = 12
_CAUTIOUS_ROUNDS = 3  # the first, of which each goes only a part of the way
_PART = 0.6
_DAMPING_MOMENTS = 4  # one of so many
_ON_THE_WAY = 0.1  # share of the moments at which all stand between nothing and their response
_MISSING = 0.05  # share of the moments at which an agent is without reactive power, as one that is lost
# What is put off is served later, and relieves as much less then: that pays where the relief now is so many times what
# it is in the best moments, or more than it costs never to serve it. Elsewhere, as where the band is always left, the
# clock stays at its top.
_BEST_MOMENTS = 0.1
_TIMES = 2.0
_CORRELATED = 4.0  # sites count as correlated where their correlation is beyond so many standard errors of chance


def site_of(scenario: Scenario, law: Law | None = None, points: OperatingPoints | None = None) -> Site:
    """Compute the data that agents have of a scenario before they are placed.

    Parameters
    ----------
    scenario
        On one feeder, see ``Scenario.member``; its regulators and capacitor banks under their own control.
    law
        Settings.
    points
        Moments of another member of the same random feeders, to be carried over; drawn where None.

    Raises
    ------
    ValueError
        For devices, or sites that draw otherwise, than the law is made for.
    """
    require_known_devices("model-aided", scenario)
    require_work_draws("model-aided", scenario)
    if points is None:
        points = operating_points(scenario, MOMENTS * (1 if scenario.schedule is None else 2))
    else:
        points = points.on(scenario)
    return Site(scenario, points, law or Law())


def commission(site: Site, buses: np.ndarray) -> Commissioned:
    """Compute the agents' data for each placement, positions in ``bus_ids`` of their buses, (m, n_agent).

    Voltages of moments without a solution, as under an extreme load, are replaced by the mean. ValueError where none
    has one.
    """
    known = [_commission(site, placement) for placement in np.asarray(buses)]
    return Commissioned(*(np.concatenate(field) for field in zip(*known, strict=True)))


def _commission(site: Site, buses: np.ndarray) -> Commissioned:
    """Compute the agents' data for one placement, (n_agent,), with a leading 1."""
    s, points, law = site.scenario, site.points, site.law
    n_dc, scale, draw = s.datacenters.count, site.kvar_share, points.p_agent_kw
    by_p, by_q = (slope[0][:, s.feeder.load_slice] / 1000.0 for slope in sensitivity_to_agents(s, buses[None]))
    levels, limit = _levels(site), site.limit_kvar(draw)
    flow = MomentFlow(site, buses)
    rng = np.random.default_rng(1)
    rest = []
    for rows in levels:
        drawn = rng.choice(rows, min(_OPTIMUM_MOMENTS, len(rows)), replace=False)
        mean_limit = limit[rows].mean(axis=0)
        rest.append(static_optimum(s, flow.at_moments(drawn), by_q, site.q_scale_kvar, mean_limit, site.effort))
    rest_kvar = np.array(rest)
    rest_at = np.array([-points.sun[rows].mean() for rows in levels]) / (s.scheduled_kva.sum() or 1.0)
    order = np.argsort(rest_at, kind="stable")
    rest_kvar, rest_at, mean_kw = rest_kvar[order], rest_at[order], draw.mean(axis=0)
    origin = rest_kvar.mean(axis=0)
    rest_all = by_sun(site, rest_kvar[None], rest_at[None], draw)
    v = flow.voltages(rest_all)
    by_q, by_p = by_q / v.mean(axis=0), by_p / v.mean(axis=0)
    v_rest, v = v, v - (rest_all - origin) @ by_q  # the latter at the origin, by the model
    by_draw = by_p.copy()
    by_draw[:n_dc] += _correlated(draw[:, :n_dc]) @ by_p[:n_dc]
    own_by_q, own_by_draw = ((slope * flow.observed_share).sum(axis=1) for slope in (by_q, by_draw))
    newest = np.ones((1, len(buses)))
    if points.later is not None:
        v_later = MomentFlow(site._replace(points=points.later), buses).voltages(rest_all)
        change = (v_later - v_rest) @ flow.observed_share.T + (points.later.p_agent_kw - draw) * own_by_draw
        newest = newest_weight(s.sensing.noise_pu, change)[None]
    start = rest_kvar @ (by_q @ flow.observed_share.T)
    still = (mean_kw, rest_kvar, rest_at, start, origin, by_q, by_q, by_p, by_draw, own_by_q, own_by_draw)
    # A model that is said to be wrong tells too little of the optimum and of the others' answers.
    trusted = float(s.sensing.r_model_share == s.sensing.x_model_share == 1.0)
    hold = trusted * law.hold * s.cost.weights.voltage * (by_q * site.q_scale_kvar[:, None]).mean(axis=1)[None]
    alike, waiting, empty = np.full((1, len(buses)), law.alike), np.full((1, n_dc), site.waiting), np.empty(0)
    fields: list[np.ndarray] = [*(field[None] for field in still), *[empty] * 6, hold, newest, alike, waiting]
    known = Commissioned(*fields)
    moved = rest_all - origin
    v_moved = v + moved @ by_q
    known = regressed(site, known, v_moved, own_v := v_moved @ flow.observed_share.T, moved)
    there = _there(rng, *draw.shape)
    relief, rounds = np.zeros((len(draw), n_dc)), int(law.rounds)  # a float where it comes from a policy's card
    for k in range(rounds):
        span_kw = np.zeros((len(draw), n_dc if k == rounds - 1 else 0))  # relief is asked for at the end alone
        kvar = origin + moved
        best = decide(site, known, DecisionInputs(own_v, draw, kvar, kvar, draw, span_kw, rest_all))
        relief = best.relief
        kvar = kvar + (_PART if k < _CAUTIOUS_ROUNDS else 1.0) * (best.share * scale - kvar)
        kvar = kvar + law.pull * site.scheduled * (rest_all - kvar)
        kvar = np.clip(kvar, -limit, limit)
        slope = trusted * slopes(own_v - moved * own_by_q, kvar)
        known = known._replace(by_own=answered(by_q, by_q @ flow.observed_share.T, slope)[None])
        moved = there * kvar - origin
        v_moved = v + moved @ by_q
        known = regressed(site, known, v_moved, own_v := v_moved @ flow.observed_share.T, moved)
    later = _TIMES * np.quantile(relief, _BEST_MOMENTS, axis=0)

    some = slice(None, None, _DAMPING_MOMENTS)
    no_clock = np.zeros((len(draw[some]), 0))

    def respond(damping: np.ndarray, share: np.ndarray) -> np.ndarray:
        kvar = share * scale
        own_v = (v[some] + (kvar - origin) @ by_q) @ flow.observed_share.T
        inputs = DecisionInputs(own_v, draw[some], kvar, kvar, draw[some], no_clock, rest_all[some])
        most = limit[some] / scale
        return np.clip(decide(site, known._replace(alike=damping[None]), inputs).share, -most, most)

    if law.rounds:
        known = known._replace(alike=settled(known.alike[0], rest_all[some] / scale, respond)[None])
    return known._replace(waiting=np.clip(later, site.waiting, max(site.waiting, site.never))[None])


def _there(rng: np.random.Generator, m: int, n: int) -> np.ndarray:
    """Share of its setpoint that each agent has at each moment, (m, n).

    The share is 1 at most moments. An agent's inference from a surprise must also be right if others are away from
    their set points. Otherwise gains are wrong away from these moments, and joint set points far from u* can agree with
    each other.
    """
    on_the_way = np.where(rng.random((m, 1)) < _ON_THE_WAY, rng.random((m, 1)), 1.0)
    return on_the_way * (rng.random((m, n)) >= _MISSING)


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
