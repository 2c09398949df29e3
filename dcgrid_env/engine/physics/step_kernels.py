"""Compiled passes over loads, phases and the joint observation, with the bits of the array forms."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.engine.physics.voltage_figures import fill_figures
from dcgrid_env.powerflow.loading import NO_VOLTAGE_PU
from dcgrid_env.powerflow.unbalance import TINY_PU


@compiled
def leg_loads(factor, leg_bus, p_kw, q_kvar):
    """Loads of the legs, kW and kvar, (2, row, n_leg): base loads (n_leg,) times a factor of their bus (row, n_bus)."""
    out = np.empty((2, factor.shape[0], len(leg_bus)))
    p, q = out[0], out[1]
    for row in range(factor.shape[0]):
        for leg in range(len(leg_bus)):
            share = factor[row, leg_bus[leg]]
            p[row, leg] = share * p_kw[leg]
            q[row, leg] = share * q_kvar[leg]
    return out


@compiled(inner=True)
def add_powers(p_net, q_net, legs, p_kw, q_kvar, begin, end):
    """Add what agents draw less what they inject to the legs of the rows from ``begin`` up to ``end``.

    The nets are of these rows alone. ``legs`` (row, n_agent, k) are flat positions row * n_leg + leg; the rest is
    (row, n_agent).
    """
    n_leg, parts = p_net.shape[1], legs.shape[2]
    for row in range(begin, end):
        for agent in range(legs.shape[1]):
            for part in range(parts):
                leg = legs[row, agent, part] - row * n_leg
                p_net[row - begin, leg] += p_kw[row, agent] / parts
                q_net[row - begin, leg] += -q_kvar[row, agent] / parts


@compiled
def net_loads(p_load_kw, q_load_kvar, legs, p_kw, q_kvar):
    """See ``dynamics.net_loads``; (2, row, n_leg)."""
    (n_row, n_leg), begin = p_load_kw.shape, len(p_load_kw) * 0
    out = np.empty((2, n_row, n_leg))
    for row in range(n_row):
        for leg in range(n_leg):
            out[0, row, leg], out[1, row, leg] = p_load_kw[row, leg], q_load_kvar[row, leg]
    add_powers(out[0], out[1], legs, p_kw, q_kvar, begin, n_row)
    return out


@compiled(inner=True)
def _fill_agents(v_pu, agent_nodes, agents):
    """Fill the mean, lowest and highest voltage of the nodes of each agent, (3, row, n_agent)."""
    flat, (n_row, n_agent, parts) = v_pu.reshape(-1), agent_nodes.shape
    for row in range(n_row):
        for agent in range(n_agent):
            low = high = total = flat[agent_nodes[row, agent, 0]]
            for part in range(1, parts):
                v = flat[agent_nodes[row, agent, part]]
                total += v
                low = v if v < low else low
                high = v if v > high else high
            agents[0, row, agent], agents[1, row, agent], agents[2, row, agent] = total / parts, low, high


@compiled(inner=True)
def _fill_unbalance(v_re_pu, v_im_pu, bus_nodes, factor):
    """See ``powerflow.unbalance_factor``, (row, n_bus)."""
    h = np.sqrt(0.75)
    for row in range(factor.shape[0]):
        for bus in range(bus_nodes.shape[0]):
            a, b, c = bus_nodes[bus, 0], bus_nodes[bus, 1], bus_nodes[bus, 2]
            sum_re = v_re_pu[row, a] - 0.5 * (v_re_pu[row, b] + v_re_pu[row, c])
            sum_im = v_im_pu[row, a] - 0.5 * (v_im_pu[row, b] + v_im_pu[row, c])
            turn_re = h * (v_re_pu[row, b] - v_re_pu[row, c])
            turn_im = h * (v_im_pu[row, b] - v_im_pu[row, c])
            positive = np.sqrt((sum_re - turn_im) ** 2 + (sum_im + turn_re) ** 2)
            factor[row, bus] = np.sqrt((sum_re + turn_im) ** 2 + (sum_im - turn_re) ** 2) / (positive + TINY_PU)


@compiled(inner=True)
def _fill_loading(v_pu, i_re_a, i_im_a, rated, before, per_a, loading):
    """See ``powerflow.branch_loading``; only entries of ``rated`` nodes are written."""
    for row in range(loading.shape[0]):
        for k, node in enumerate(rated):
            i_re, i_im = i_re_a[row, node], i_im_a[row, node]
            ratio = v_pu[row, node] / (v_pu[row, before[k]] + NO_VOLTAGE_PU)
            loading[row, node] = np.sqrt(i_re * i_re + i_im * i_im) * per_a[k] * (1.0 + max(ratio - 1.0, 0.0))


@compiled
def phase_figures(
    v_pu, v_re_pu, v_im_pu, i_re_a, i_im_a, agent_nodes, bus_nodes, rated, before, per_a, first, band_pu
):  # fmt: skip
    """Figures of a power flow, see ``node_figures.PhaseFigures``.

    Parameters
    ----------
    v_pu, v_re_pu, v_im_pu, i_re_a, i_im_a
        Voltages and currents of ``ThreePhaseSolution``, (row, n_node).
    agent_nodes, bus_nodes
        Nodes of each agent, flat positions (row, n_agent, k), and of each three-phase bus, (n_bus, 3).
    rated, before, per_a
        Nodes whose branch has a rating, what the ratio of the branch's voltages is to, which is the node itself except
        behind a regulator, and 1 / rating, (n_rated,) each.
    first, band_pu
        First node whose voltage is judged, and the half width of its band.

    Returns
    -------
    agents, unbalance, loading, per_row
        Mean, lowest and highest voltage of each agent, (3, row, n_agent); (row, n_bus); (row, n_node); and
        ``VoltageFigures``, (4, row).
    """
    n_row, n_node = v_pu.shape
    agents, unbalance = np.empty((3, n_row, agent_nodes.shape[1])), np.empty((n_row, bus_nodes.shape[0]))
    loading, per_row = np.zeros((n_row, n_node)), np.empty((4, n_row))
    _fill_agents(v_pu, agent_nodes, agents)
    _fill_unbalance(v_re_pu, v_im_pu, bus_nodes, unbalance)
    _fill_loading(v_pu, i_re_a, i_im_a, rated, before, per_a, loading)
    fill_figures(v_pu, 0, n_row, first, band_pu, per_row[0], per_row[1], per_row[2], per_row[3])
    return agents, unbalance, loading, per_row


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
