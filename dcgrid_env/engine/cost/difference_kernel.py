"""Compiled form of ``difference.add_saved_costs`` for a voltage cost of the form l1."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.devices.converter_kernel import dispatch_one

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
def add_saved_costs_rows(
    begin, end, v_pu, nodes, by_p, by_q, is_squared, targets, uncharged_pu, band_pu, w_voltage, w_violation,
    effort, agent, first_change, is_reactive, reactive_entry, has_reactive, s_rated_kva, q_max_kvar, setpoints,
    default, p_kw, q_kvar, drawn_kw, available, saved,
):  # fmt: skip
    """Add to ``saved`` (row, n_action) for the rows from ``begin`` up to ``end``; see ``difference.add_saved_costs``.

    ``available`` has no rows if all devices are.
    """
    n_node, n_seen = v_pu.shape[1], by_p.shape[1]
    first, parts = n_node - n_seen, nodes.shape[2]
    moved, per_v = np.empty(n_seen), np.ones(n_seen)
    for row in range(begin, end):
        v = v_pu[row, first:]
        if is_squared:
            for j in range(n_seen):
                per_v[j] = 1.0 / v[j]
        now = _cost_with(v, per_v, v, 0.0, targets, uncharged_pu, band_pu, w_voltage, w_violation)
        for entry in range(saved.shape[1]):
            more, is_moved = 0.0, False
            is_one = first_change[entry + 1] == first_change[entry] + 1 and parts == 1
            for change in range(first_change[entry], first_change[entry + 1]):
                i, p_now, asked = agent[change], p_kw[row, agent[change]], 0.0
                p = p_now if is_reactive[change] else drawn_kw[row, change]
                if has_reactive[change]:
                    given = default if is_reactive[change] else setpoints
                    asked = given[row, reactive_entry[change]]
                q, _ = dispatch_one(s_rated_kva[i], q_max_kvar[i], p, asked)
                if len(available):
                    p, q = p * available[row, i], q * available[row, i]
                more += effort[i] * (abs(q) - abs(q_kvar[row, i]))
                p, q = (p - p_now) / parts, (q - q_kvar[row, i]) / parts
                if p == 0.0 and q == 0.0:
                    continue
                if is_one and p == 0.0:
                    by = by_q[nodes[row, i, 0] - row * n_node]
                    more += _cost_with(v, per_v, by, q, targets, uncharged_pu, band_pu, w_voltage, w_violation) - now
                    continue
                if not is_moved:
                    moved[:], is_moved = 0.0, True
                for part in range(parts):
                    node = nodes[row, i, part] - row * n_node
                    for j in range(n_seen):
                        moved[j] += by_q[node, j] * q - by_p[node, j] * p
            if is_moved:
                more += _cost_with(v, per_v, moved, 1.0, targets, uncharged_pu, band_pu, w_voltage, w_violation) - now
            saved[row, entry] += more
    return 0
