"""The capacitor banks' measurements and controls compiled, lane by lane, with the bits of the array forms."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled


@compiled
def measured_banks(settings, v, re, im, i_re, i_im):
    """Mean voltage and reactive power of each bank, (2, row, n_capacitor), from figures of all nodes, (row, node)."""
    lanes, n = v.shape[0], len(settings.kvar_per_pu_a)
    out = np.empty((2, lanes, n))
    k = len(settings.nodes) // max(n, 1)
    for lane in range(lanes):
        for bank in range(n):
            volts, kvar = 0.0, 0.0
            for node in settings.nodes[bank * k : (bank + 1) * k]:
                volts += v[lane, node]
                kvar += im[lane, node] * i_re[lane, node] - re[lane, node] * i_im[lane, node]
            out[0, lane, bank] = volts / k
            out[1, lane, bank] = kvar / k * settings.kvar_per_pu_a[bank]
    return out


@compiled
def control_banks(by_voltage, on_at, off_at, delay_s, state, dt_s, controlled, same_time_s):
    """What ``capacitor_control.control_banks`` does: on, time beyond a threshold, time since, switched, switchings.

    (5, row, n_capacitor); a bank goes on below ``on_at`` and off above ``off_at`` by voltage, the other way by kvar.
    """
    lanes, n = state.on.shape
    out = np.empty((5, lanes, n))
    for lane in range(lanes):
        for bank in range(n):
            on, value = state.on[lane, bank], state.kvar_share[lane, bank]
            low, high = value > on_at, value < off_at
            if by_voltage:
                low, high = state.v_pu[lane, bank] < on_at, state.v_pu[lane, bank] > off_at
            beyond = controlled[bank] > 0.0 and ((low and on < 0.5) or (high and on > 0.5))
            waited = state.beyond_s[lane, bank] + dt_s if beyond else 0.0
            due = beyond and waited >= delay_s - same_time_s
            out[0, lane, bank] = 1.0 - on if due else on
            out[1, lane, bank] = 0.0 if due else waited
            out[2, lane, bank] = 0.0 if due else state.since_s[lane, bank] + dt_s
            out[3, lane, bank] = 1.0 if due else 0.0
            out[4, lane, bank] = state.switchings[lane, bank] + out[3, lane, bank]
    return out
