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
    """Find constant reactive injections, kvar, (n_agent,), by L-BFGS-B on repeated linearisations of the voltages.

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
    from dcgrid_env.baselines.model_aided.smoothed_cost import smoothed_cost  # which brings the compiler with it

    w, band = scenario.cost.weights, scenario.cost.band_pu
    scale = np.where(q_scale_kvar > 0.0, q_scale_kvar, 1.0)
    bounds = [(-limit, limit) for limit in limit_kvar / scale]
    q_kvar = np.zeros(len(scale))
    for _ in range(_ROUNDS):
        v = voltages(q_kvar)
        by_share = by_q / v.mean(axis=0) * scale[:, None]
        around = q_kvar / scale
        at_zero = v - 1.0 - around @ by_share

        def cost(share: np.ndarray) -> tuple[float, np.ndarray]:
            e = at_zero + share @ by_share  # noqa: B023 (called within the round alone)
            total, by_bus = smoothed_cost(e, w.voltage, w.violation, band, _SMOOTH_PU)
            used = np.sqrt(share * share + _SMOOTH_SHARE**2)
            slope = by_share @ by_bus / e.size + effort * share / used  # noqa: B023
            return total / e.size + float(effort @ used), slope

        q_kvar = scale * minimize(cost, around, jac=True, bounds=bounds, method="L-BFGS-B").x
    return q_kvar
