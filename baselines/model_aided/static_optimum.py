"""The reactive setpoints that never move and cost least on average over some moments."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from dcgrid_env import Scenario

_SMOOTH_PU = 3e-4  # half width over which the cost's kinks are rounded, for a method that wants a gradient
_ROUNDS = 3  # linearisations; the third moves the setpoints by less than 1e-3 of their limits
_SMOOTH_SHARE = 1e-3


def static_optimum(
    scenario: Scenario,
    voltages: Callable[[np.ndarray], np.ndarray],
    by_q: np.ndarray,
    q_scale_kvar: np.ndarray,
    limit_kvar: np.ndarray,
    effort: np.ndarray,
) -> np.ndarray:
    """Find constant reactive injections, kvar, (n_agent,), by L-BFGS-B on the voltages' linearisation, made anew.

    Parameters
    ----------
    scenario
        Gives the weights of the cost.
    voltages
        Voltages of the moments under reactive injections, p.u., (m, n_node), by the exact power flow.
    by_q
        What each agent's injection does around 1 p.u., p.u. per kvar, (n_agent, n_node).
    q_scale_kvar, limit_kvar
        Limits at zero active power, and at the mean draw, (n_agent,).
    effort
        Price of a whole limit of each agent, (n_agent,).
    """
    w, band = scenario.weights, scenario.band_pu
    scale = np.where(q_scale_kvar > 0.0, q_scale_kvar, 1.0)
    bounds = [(-limit, limit) for limit in limit_kvar / scale]
    q_kvar = np.zeros(len(scale))
    for _ in range(_ROUNDS):
        v = voltages(q_kvar)
        by_share = by_q / v.mean(axis=0) * scale[:, None]
        around, offset = q_kvar / scale, v - 1.0

        def cost(share: np.ndarray) -> tuple[float, np.ndarray]:
            e = offset + (share - around) @ by_share  # noqa: B023 (called within the round alone)
            size = np.hypot(e, _SMOOTH_PU)
            over, past = (np.clip(x / _SMOOTH_PU, -500.0, 500.0) for x in (e - band, -e - band))
            beyond = _SMOOTH_PU * (np.logaddexp(0.0, over) + np.logaddexp(0.0, past))
            moved = w.voltage * e / size + w.violation * (1.0 / (1.0 + np.exp(-over)) - 1.0 / (1.0 + np.exp(-past)))
            used = np.hypot(share, _SMOOTH_SHARE)
            slope = moved.sum(axis=0) @ by_share.T / e.size + effort * share / used  # noqa: B023
            return float(w.voltage * size.mean() + w.violation * beyond.mean() + effort @ used), slope

        q_kvar = scale * minimize(cost, around, jac=True, bounds=bounds, method="L-BFGS-B").x
    return q_kvar
