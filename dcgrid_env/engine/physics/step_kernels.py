"""Compiled passes over loads, phases and the joint observation, with the bits of the array forms."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.powerflow.unbalance import TINY_PU


@compiled
def leg_loads(factor, leg_bus, p_kw, q_kvar):
    """Loads of the legs, kW and kvar, (row, n_leg): base loads (n_leg,) times a factor of their bus (row, n_bus)."""
    p, q = np.empty((factor.shape[0], len(leg_bus))), np.empty((factor.shape[0], len(leg_bus)))
    for row in range(factor.shape[0]):
        for leg in range(len(leg_bus)):
            share = factor[row, leg_bus[leg]]
            p[row, leg] = share * p_kw[leg]
            q[row, leg] = share * q_kvar[leg]
    return p, q


@compiled
def setpoints(action, middle, half_range, lowest, highest):
    """Setpoints (row, n_action) of actions, which are cut: the middle of a range and a part of its half."""
    low, high = lowest[()], highest[()]
    out = np.empty(action.shape)
    for row in range(action.shape[0]):
        for i in range(action.shape[1]):
            out[row, i] = middle[i] + half_range[i] * min(max(action[row, i], low), high)
    return out


@compiled
def net_loads(p_load_kw, q_load_kvar, legs, p_kw, q_kvar):
    """See ``dynamics.net_loads``."""
    p_net, q_net = p_load_kw.copy(), q_load_kvar.copy()
    p_at, q_at = p_net.reshape(-1), q_net.reshape(-1)
    n_row, agents, parts = legs.shape
    for row in range(n_row):
        for agent in range(agents):
            for part in range(parts):
                leg = legs[row, agent, part]
                p_at[leg] += p_kw[row, agent] / parts
                q_at[leg] += -q_kvar[row, agent] / parts
    return p_net, q_net


@compiled
def by_phase(v_pu, v_re_pu, v_im_pu, agent_nodes, bus_nodes):
    """See ``dynamics.by_phase`` and ``powerflow.unbalance``."""
    n_row, agents, parts = agent_nodes.shape
    lowest, highest = np.empty((n_row, agents)), np.empty((n_row, agents))
    factor = np.empty((n_row, bus_nodes.shape[0]))
    flat, h = v_pu.reshape(-1), np.sqrt(0.75)
    for row in range(n_row):
        for agent in range(agents):
            low = high = flat[agent_nodes[row, agent, 0]]
            for part in range(1, parts):
                v = flat[agent_nodes[row, agent, part]]
                low = v if v < low else low
                high = v if v > high else high
            lowest[row, agent], highest[row, agent] = low, high
        for bus in range(bus_nodes.shape[0]):
            a, b, c = bus_nodes[bus, 0], bus_nodes[bus, 1], bus_nodes[bus, 2]
            sum_re = v_re_pu[row, a] - 0.5 * (v_re_pu[row, b] + v_re_pu[row, c])
            sum_im = v_im_pu[row, a] - 0.5 * (v_im_pu[row, b] + v_im_pu[row, c])
            turn_re = h * (v_re_pu[row, b] - v_re_pu[row, c])
            turn_im = h * (v_im_pu[row, b] - v_im_pu[row, c])
            positive = np.sqrt((sum_re - turn_im) ** 2 + (sum_im + turn_re) ** 2)
            factor[row, bus] = np.sqrt((sum_re + turn_im) ** 2 + (sum_im - turn_re) ** 2) / (positive + TINY_PU)
    return lowest, highest, factor


@compiled
def joint_observation(raw, scale, column, low, high):
    """The joint observation as float32, (row, n): of each entry the scaled raw figure in its column, cut to bounds.

    ``raw`` is (row, n_raw), ``scale`` (n_raw,), the rest (n,).
    """
    out = np.empty((raw.shape[0], len(column)), np.float32)
    for row in range(raw.shape[0]):
        for i in range(len(column)):
            x = np.float32(raw[row, column[i]] * scale[column[i]])
            x = low[i] if x < low[i] else x
            out[row, i] = high[i] if x > high[i] else x
    return out
