"""The reactive setpoint that is best for an agent's estimate of all voltages, if all agents move alike.

    find t with    sum_k c'(V^_k + t O_k) X_ik q_i + effort'(u + t) + hold (u + t - u*) = 0

c' is the slope of the expected cost (``expected_cost``), X_ik what the agent's own reactive power does to bus k, u its
setpoint as a share of its limit q_i, and O_k what all agents do to bus k when each moves by its whole limit. The
gradient is the agent's own; the voltages it is taken at are those after all have moved as it does. Without that each
agent would do all that is missing, and together they would overshoot by the number of agents. The left side rises with
t, so that bisection finds its zero; steps by the local slope alone (Newton) oscillate, as the cost is almost piecewise
linear where voltages are known well.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env.baselines.model_aided.expected_cost import VoltagePrice

_KINK = 1e-3  # share of the limit over which the price of effort turns from one sign to the other


def best_response(
    price: VoltagePrice,
    v_pu: np.ndarray,
    s_pu: np.ndarray,
    by_all: np.ndarray,
    by_own: np.ndarray,
    share: np.ndarray,
    limit: np.ndarray,
    effort: np.ndarray,
    hold: float,
    rest: np.ndarray,
    halvings: int = 9,
) -> np.ndarray:
    """New setpoints as shares of the agents' limits at zero active power.

    Parameters
    ----------
    price
        What deviations cost.
    v_pu, s_pu
        Each agent's estimate of every voltage if nothing moves, and its standard deviation, p.u., (m, n_agent, n_node).
    by_all, by_own
        What the voltages do when all agents, or one alone, inject their whole limit more, p.u., (m, n_agent, n_node).
    share, limit
        Setpoints now and the largest possible, (m, n_agent).
    effort, hold, rest
        Price of a whole limit of reactive power; strength and place of the pull towards the static optimum.
    halvings
        Bisections of the range, which leave an error of 2^-halvings of it.
    """
    low, high = -limit, np.maximum(limit, -limit)
    for _ in range(halvings):
        middle = (low + high) / 2.0
        v = v_pu + (middle - share)[..., None] * by_all
        rise = (price.slope(v, s_pu) * by_own).sum(axis=-1)
        rise = rise + effort * np.tanh(middle / _KINK) + hold * (middle - rest)
        low, high = np.where(rise < 0.0, middle, low), np.where(rise < 0.0, high, middle)
    return (low + high) / 2.0
