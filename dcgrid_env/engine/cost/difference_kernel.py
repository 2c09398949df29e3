"""Compiled form of ``difference.saved_costs`` for a voltage cost of the form l1."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled


@compiled(inner=True, fastmath={"reassoc", "nsz", "contract"})
def _cost(v_pu, targets, uncharged_pu, band_pu, w_voltage, w_violation):
    """Voltage and violation cost of voltages (n_node,)."""
    off, beyond = 0.0, 0.0
    for j in range(len(v_pu)):
        off += max(abs(v_pu[j] - targets[j]) - uncharged_pu, 0.0)
        beyond += max(abs(v_pu[j] - 1.0) - band_pu, 0.0)
    return w_voltage * off + w_violation * beyond


@compiled(nogil=True)
def saved_costs_rows(
    begin, end, v_pu, nodes, by_p, by_q, is_squared, targets, uncharged_pu, band_pu, w_voltage, w_violation,
    effort, agent, first_change, q_kvar, p_change, q_change, out,
):  # fmt: skip
    """Fill ``out`` (row, n_action) for the rows from ``begin`` up to ``end``; see ``difference.saved_costs``."""
    n_node, n_seen = v_pu.shape[1], by_p.shape[1]
    first, parts = n_node - n_seen, nodes.shape[2]
    moved = np.empty(n_seen)
    for row in range(begin, end):
        v = v_pu[row, first:]
        now = _cost(v, targets, uncharged_pu, band_pu, w_voltage, w_violation)
        for entry in range(out.shape[1]):
            moved[:] = 0.0
            more = 0.0
            for change in range(first_change[entry], first_change[entry + 1]):
                i, p, q = agent[change], p_change[row, change] / parts, q_change[row, change] / parts
                if p == 0.0 and q == 0.0:
                    continue
                q_now = q_kvar[row, i]
                more += effort[i] * (abs(q_now + q_change[row, change]) - abs(q_now))
                for part in range(parts):
                    node = nodes[row, i, part] - row * n_node
                    for j in range(n_seen):
                        moved[j] += by_q[node, j] * q - by_p[node, j] * p
            for j in range(n_seen):
                moved[j] = v[j] + (moved[j] / v[j] if is_squared else moved[j])
            out[row, entry] = _cost(moved, targets, uncharged_pu, band_pu, w_voltage, w_violation) - now + more
    return 0
