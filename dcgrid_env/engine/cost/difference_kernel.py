"""Compiled form of ``difference.saved_costs`` for a voltage cost of the form l1."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled

SUMS = {"reassoc", "nsz", "contract"}
"""Liberties that the compiler may take in sums over nodes, which it then vectorises."""


@compiled(inner=True, fastmath=SUMS)
def _cost_with(v_pu, per_v, by, change, targets, uncharged_pu, band_pu, w_voltage, w_violation):
    """Voltage and violation cost after a change of one power, by which voltages (n_node,) change as ``by`` over v."""
    off, beyond = 0.0, 0.0
    for j in range(len(v_pu)):
        v = v_pu[j] + by[j] * change * per_v[j]
        from_target = abs(v - targets[j]) - uncharged_pu
        from_one = abs(v - 1.0) - band_pu
        off += from_target if from_target > 0.0 else 0.0
        beyond += from_one if from_one > 0.0 else 0.0
    return w_voltage * off + w_violation * beyond


@compiled(nogil=True)
def saved_costs_rows(
    begin, end, v_pu, nodes, by_p, by_q, is_squared, targets, uncharged_pu, band_pu, w_voltage, w_violation,
    effort, agent, first_change, q_kvar, p_change, q_change, out,
):  # fmt: skip
    """Fill ``out`` (row, n_action) for the rows from ``begin`` up to ``end``; see ``difference.saved_costs``."""
    n_node, n_seen = v_pu.shape[1], by_p.shape[1]
    first, parts = n_node - n_seen, nodes.shape[2]
    moved, per_v = np.empty(n_seen), np.ones(n_seen)
    for row in range(begin, end):
        v = v_pu[row, first:]
        if is_squared:
            for j in range(n_seen):
                per_v[j] = 1.0 / v[j]
        now = _cost_with(v, per_v, v, 0.0, targets, uncharged_pu, band_pu, w_voltage, w_violation)
        for entry in range(out.shape[1]):
            change, end_change = first_change[entry], first_change[entry + 1]
            if end_change == change + 1 and parts == 1 and p_change[row, change] == 0.0:
                q, i = q_change[row, change], agent[change]
                saved = 0.0
                if q != 0.0:
                    by = by_q[nodes[row, i, 0] - row * n_node]
                    moved_cost = _cost_with(v, per_v, by, q, targets, uncharged_pu, band_pu, w_voltage, w_violation)
                    saved = moved_cost - now + effort[i] * (abs(q_kvar[row, i] + q) - abs(q_kvar[row, i]))
                out[row, entry] = saved
                continue
            moved[:] = 0.0
            more = 0.0
            for change in range(first_change[entry], end_change):
                i, p, q = agent[change], p_change[row, change] / parts, q_change[row, change] / parts
                if p == 0.0 and q == 0.0:
                    continue
                q_now = q_kvar[row, i]
                more += effort[i] * (abs(q_now + q_change[row, change]) - abs(q_now))
                for part in range(parts):
                    node = nodes[row, i, part] - row * n_node
                    for j in range(n_seen):
                        moved[j] += by_q[node, j] * q - by_p[node, j] * p
            moved_cost = _cost_with(v, per_v, moved, 1.0, targets, uncharged_pu, band_pu, w_voltage, w_violation)
            out[row, entry] = moved_cost - now + more
    return 0
