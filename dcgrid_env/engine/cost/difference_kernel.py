"""Compiled form of ``difference.add_saved_costs`` for a voltage cost of the form l1, with the payment for taps."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.devices import converter
from dcgrid_env.engine.cost.tap_credit import MARGIN, WIDTH
from dcgrid_env.scenario.costs import voltage_reference

dispatch, beyond_band = converter.dispatch.scalar, voltage_reference.beyond_band.scalar
SUMS = {"reassoc", "nsz", "contract"}
"""Liberties that the compiler may take in sums over nodes, which it then vectorises."""


@compiled(inner=True, fastmath=SUMS)
def _cost_with(v_pu, per_v, by, change, targets, uncharged_pu, band_pu, w_voltage, w_violation):
    """Voltage and violation cost after a change of one power, by which voltages (n_node,) change as ``by`` over v."""
    cost = 0.0
    for j in range(len(v_pu)):
        v = v_pu[j] + by[j] * change * per_v[j]
        cost += w_voltage * beyond_band(v - targets[j], uncharged_pu)
        cost += w_violation * beyond_band(v - 1.0, band_pu)
    return cost


@compiled(inner=True)
def _nearness(off_v, half_v):
    """Smooth condition of a relay whose timer advances, see ``tap_credit``."""
    return np.exp(min((off_v / half_v - 1.0 - MARGIN) / WIDTH, 0.0))


@compiled(nogil=True)
def add_saved_costs_rows(
    begin, end, v_pu, group, by_p, by_q, is_squared, targets, uncharged_pu, band_pu, w_voltage, w_violation,
    effort, agent, first_change, is_reactive, reactive_entry, has_reactive, s_rated_kva, q_max_kvar, setpoints,
    default, p_kw, q_kvar, drawn_kw, available, relay_by_p, relay_by_q, relay_off_v, relay_half_v, relay_worth, saved,
):  # fmt: skip
    """Add to ``saved`` (row, n_action) for the rows from ``begin`` up to ``end``; see ``difference.add_saved_costs``.

    ``available`` has no rows if all devices are. The arrays of relays have no columns if no tap is paid.
    """
    n_seen, n_relay = by_p.shape[1], relay_half_v.shape[0]
    first = v_pu.shape[1] - n_seen
    moved, per_v = np.empty(n_seen), np.ones(n_seen)
    moved_v, near = np.empty(n_relay), np.empty(n_relay)
    for row in range(begin, end):
        v = v_pu[row, first:]
        if is_squared:
            for j in range(n_seen):
                per_v[j] = 1.0 / v[j]
        for k in range(n_relay):
            near[k] = _nearness(relay_off_v[row, k], relay_half_v[k])
        now = _cost_with(v, per_v, v, 0.0, targets, uncharged_pu, band_pu, w_voltage, w_violation)
        for entry in range(saved.shape[1]):
            more, is_summed, is_one = 0.0, False, first_change[entry + 1] == first_change[entry] + 1
            moved_v[:] = 0.0
            for change in range(first_change[entry], first_change[entry + 1]):
                i, p_now, requested = agent[change], p_kw[row, agent[change]], 0.0
                p = p_now if is_reactive[change] else drawn_kw[row, change]
                if has_reactive[change]:
                    source = default if is_reactive[change] else setpoints
                    requested = source[row, reactive_entry[change]]
                q, _ = dispatch(s_rated_kva[i], q_max_kvar[i], p, requested)
                if len(available):
                    p, q = p * available[row, i], q * available[row, i]
                more += effort[i] * (abs(q) - abs(q_kvar[row, i]))
                p, q, node_group = p - p_now, q - q_kvar[row, i], group[row, i]
                for k in range(n_relay):
                    moved_v[k] += relay_by_q[node_group, k] * q - relay_by_p[node_group, k] * p
                if p == 0.0 and q == 0.0:
                    continue
                if is_one and (p == 0.0 or q == 0.0):
                    by, power = (by_q[node_group], q) if p == 0.0 else (by_p[node_group], -p)
                    more += (
                        _cost_with(v, per_v, by, power, targets, uncharged_pu, band_pu, w_voltage, w_violation) - now
                    )
                    continue
                if not is_summed:
                    moved[:], is_summed = 0.0, True
                for j in range(n_seen):
                    moved[j] += by_q[node_group, j] * q - by_p[node_group, j] * p
            if is_summed:
                more += _cost_with(v, per_v, moved, 1.0, targets, uncharged_pu, band_pu, w_voltage, w_violation) - now
            for k in range(n_relay):
                if moved_v[k] != 0.0:
                    more += relay_worth[row, k] * (
                        near[k] - _nearness(relay_off_v[row, k] + moved_v[k], relay_half_v[k])
                    )
            saved[row, entry] += more
    return 0
