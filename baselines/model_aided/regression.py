"""Estimate all voltages from an agent's own: one normal variable from another.

    E_k = V_k - X_ik (q_i - u*_i) + D_ik (p_i - mean p_i)          D: own drop, and that of sites that draw as it draws

are the voltages without the agent's own part. Around a level of the sun that an inverter reads
from its own injection, and the others from E_i, with C the covariance over the moments of that level,

    E[E_k | E_i] = base_k + g_ik (E_i - base_i)      g_ik = C_ki / (C_ii + noise)      s_ik^2 = C_kk - C_ki g_ik

(for instance S. M. Kay, "Fundamentals of statistical signal processing: estimation theory", 1993, chapter 12). The
covariances of E follow from those of the voltages with the own setpoints and draws, so that E itself is made nowhere.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env.baselines.model_aided.knowledge import Commissioned, Site


def regressed(site: Site, known: Commissioned, v: np.ndarray, own_v: np.ndarray, moved: np.ndarray) -> Commissioned:
    """``known`` of one placement with each agent's estimate from the moments.

    Parameters
    ----------
    site, known
        What is known so far; ``key .. by_all`` are made here.
    v
        Voltages of the moments, p.u., (m, k).
    own_v
        What of them each agent sees, p.u., (m, n).
    moved
        Setpoints at which they are less ``origin_kvar``, kvar, (m, n).
    """
    s, draw, law = site.scenario, site.points.p_agent_kw, site.law
    (by_q,), (by_draw,) = known.by_q, known.by_draw
    centre, own_centre = v.mean(axis=0), own_v.mean(axis=0)
    there = v - centre
    more = draw - known.mean_kw[0]
    unexplained = own_v - own_centre - moved * known.own_by_q[0] + more * known.own_by_draw[0]
    weights = _weights(np.where(site.scheduled, draw, unexplained), known.rest_at.shape[1])
    columns = np.stack([unexplained.T, moved.T, more.T])  # what E is made of, beside the voltages, (3, n, m)
    mean = (columns[:, :, None] * weights).sum(axis=-1)
    parts = columns[:, :, None] - mean[..., None]  # (3, n, L, m)
    weighed = weights * parts
    with_v = _product(weighed, there)  # covariances with the voltages, (3, n, L, k)
    within = np.einsum("cnlm,dnlm->cdnl", weighed, parts)
    mean_v = _product(weights, there)
    var_v = _product(weights, there * there) - mean_v * mean_v
    x, d = by_q[:, None], by_draw[:, None]
    (o, q, p), (v_own, v_q, v_p) = range(3), with_v
    c = within[..., None]
    with_own = v_own - c[o, q] * x + c[o, p] * d
    variance = var_v + c[q, q] * x * x + c[p, p] * d * d - 2.0 * (v_q * x - v_p * d + c[q, p] * x * d)
    noise = (s.sensing.noise_pu**2 * known.newest[0] + (0.1 * law.floor_pu) ** 2)[:, None, None]
    gain = with_own / (c[o, o] + noise)
    left = np.maximum(variance - with_own * gain, 0.0)
    own_base = mean[o] + own_centre[:, None]
    key = np.where(site.scheduled[:, None], mean[p] + known.mean_kw[0][:, None], own_base)
    by_all = _product(_product(weights, site.limit_kvar(draw)), by_q)
    return known._replace(
        key=key[None],
        base_pu=(centre + mean_v - mean[q][..., None] * x + mean[p][..., None] * d)[None],
        own_base_pu=own_base[None],
        gain=gain[None],
        inverse_spread=1.0 / np.sqrt(left + law.floor_pu**2)[None],
        by_all=np.broadcast_to(by_all, gain.shape)[None],
    )


def _weights(level_of: np.ndarray, n_level: int) -> np.ndarray:
    """Weight of each moment in the means of an agent's levels, of as many moments each, (n, L, m).

    With one level they are those of all agents, (1, 1, m).
    """
    n_moment, n = level_of.shape
    if n_level == 1:
        return np.full((1, 1, n_moment), 1.0 / n_moment)
    sizes = [len(rows) for rows in np.array_split(np.arange(n_moment), n_level)]
    level = np.empty((n, n_moment), int)
    np.put_along_axis(level, np.argsort(level_of.T, kind="stable"), np.repeat(np.arange(n_level), sizes)[None], axis=-1)
    return (level[:, None] == np.arange(n_level)[:, None]) / np.array(sizes)[:, None]


def _product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """``left @ right`` for (.., a, b) and (b, c), as one product of matrices."""
    return (left.reshape(-1, left.shape[-1]) @ right).reshape(*left.shape[:-1], right.shape[-1])
