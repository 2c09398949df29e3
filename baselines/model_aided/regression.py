"""What moments tell an agent of all voltages, given its own: the estimate of one normal variable from another.

    E_k = V_k - X_ik (q_i - u*_i) + D_ik (p_i - mean p_i)          D: own drop, and that of sites that draw as it draws

is what remains of the voltages once the agent's own part is taken out. Around a level of the sun that an inverter reads
from its own injection, and the others from E_i, with C the covariance over the moments of that level,

    E[E_k | E_i] = base_k + g_ik (E_i - base_i)      g_ik = C_ki / (C_ii + noise)      s_ik^2 = C_kk - C_ki g_ik

(for instance S. M. Kay, "Fundamentals of statistical signal processing: estimation theory", 1993, chapter 12). The
covariances of E follow from those of the voltages with the own setpoints and draws, so that E itself is made nowhere.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env.baselines.model_aided.knowledge import Commissioned, Site


def regressed(site: Site, known: Commissioned, v: np.ndarray, moved: np.ndarray, seen: np.ndarray) -> Commissioned:
    """``known`` of one placement with what the moments tell each agent.

    Parameters
    ----------
    site, known
        What is known so far; ``key .. by_all`` are made here.
    v
        Voltages of the moments at the origin of the setpoints, p.u., (m, k).
    moved
        Setpoints less that origin, kvar, (m, n).
    seen
        Share of each voltage in what an agent sees, (n, k).
    """
    s, draw, law = site.scenario, site.points.p_agent_kw, site.law
    (by_q,), (by_draw,) = known.by_q, known.by_draw
    own_q, own_draw = known.own_by_q[0], known.own_by_draw[0]
    centre = v.mean(axis=0)
    there = v - centre + moved @ by_q
    more = draw - known.mean_kw[0]
    own = there @ seen.T - moved * own_q + more * own_draw
    weights = _weights(np.where(site.scheduled, draw, own), known.rest_at.shape[1])
    columns = np.stack([own, moved, more])  # what E is made of, beside the voltages
    mean = np.einsum("nlm,cmn->cnl", weights, columns)
    parts = columns.transpose(0, 2, 1)[:, :, None] - mean[..., None]  # (3, n, L, m)
    weighed = weights * parts
    with_v = weighed @ there  # covariances with the voltages, (3, n, L, k)
    within = np.einsum("cnlm,dnlm->cdnl", weighed, parts)
    mean_v = weights @ there
    var_v = weights @ (there * there) - mean_v * mean_v
    x, d = by_q[:, None], by_draw[:, None]
    (o, q, p), (own_v, q_v, p_v) = range(3), with_v
    c = within[..., None]
    with_own = own_v - c[o, q] * x + c[o, p] * d
    variance = var_v + c[q, q] * x * x + c[p, p] * d * d - 2.0 * (q_v * x - p_v * d + c[q, p] * x * d)
    noise = s.voltage_noise_pu**2 + (0.1 * law.floor_pu) ** 2
    gain = with_own / (c[o, o] + noise)
    left = np.maximum(variance - with_own * gain, 0.0)
    key = np.where(site.scheduled[:, None], mean[p] + known.mean_kw[0][:, None], mean[o] + (seen @ centre)[:, None])
    limit = weights @ site.limit_kvar(draw)
    return known._replace(
        key=key[None],
        base_pu=(centre + mean_v - mean[q][..., None] * x + mean[p][..., None] * d)[None],
        own_base_pu=(mean[o] + (seen @ centre)[:, None])[None],
        gain=gain[None],
        inverse_spread=1.0 / np.sqrt(left + law.floor_pu**2)[None],
        by_all=(limit @ by_q)[None],
    )


def _weights(level_of: np.ndarray, n_level: int) -> np.ndarray:
    """Weight of each moment in the means of an agent's levels, of as many moments each, (n, L, m)."""
    sizes = [len(rows) for rows in np.array_split(np.arange(len(level_of)), n_level)]
    rank = np.argsort(np.argsort(level_of, axis=0, kind="stable"), axis=0, kind="stable")
    of = np.repeat(np.arange(n_level), sizes)[rank]
    return (of.T[:, None] == np.arange(n_level)[:, None]) / np.array(sizes)[:, None]
