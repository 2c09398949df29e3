"""The relays and controls of regulators compiled, one environment after the other, with the bits of the array forms."""

from __future__ import annotations

import math

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.devices.tap_changer.regulator_state import SAME_TIME_S


@compiled
def relay_volts(settings, v_re_pu, v_im_pu, i_re_a, i_im_a):
    """See ``relay.relay_volts``."""
    out = np.empty((len(v_re_pu), len(settings.node)))
    for row in range(len(v_re_pu)):
        for r, node in enumerate(settings.node):
            gain, i_re, i_im = settings.volts_per_pu[r], i_re_a[row, node], i_im_a[row, node]
            v_re = v_re_pu[row, node] - settings.is_between[r] * v_re_pu[row, settings.other[r]]
            v_im = v_im_pu[row, node] - settings.is_between[r] * v_im_pu[row, settings.other[r]]
            re = v_re * gain - settings.r_ohm[r] * i_re + settings.x_ohm[r] * i_im
            im = v_im * gain - settings.r_ohm[r] * i_im - settings.x_ohm[r] * i_re
            out[row, r] = math.hypot(re, im) - settings.z_ohm[r] * math.hypot(i_re, i_im)
    return out


@compiled(inner=True)
def _direct(settings, target_v, half_band_v, acts, volts, tap, wanted):
    """Write the direction of each regulator's next tap into ``wanted``."""
    for r in range(len(tap)):
        missing_v = target_v[r] - volts[r]
        wanted[r] = 0.0
        if acts[r] != 0.0:
            if missing_v > half_band_v[r] and tap[r] < settings.highest[r]:
                wanted[r] = 1.0
            elif missing_v < -half_band_v[r] and tap[r] > settings.lowest[r]:
                wanted[r] = -1.0


@compiled
def next_taps(settings, state, band, left_s, due_s, integrating, controlled):
    """What ``timed_taps.next_taps`` does: the fields of the state and the time passed, (8, row, n_regulator)."""
    n_row, n = state.tap.shape
    out = np.empty((8, n_row, n))
    wanted, due_in = np.empty(n), np.empty(n)
    acts = np.ones(n) if controlled is None else controlled
    for row in range(n_row):
        tap, volts, waited, sequence, since, moved, moves = (
            out[0, row], out[1, row], out[2, row], out[3, row], out[4, row], out[5, row], out[6, row],
        )  # fmt: skip
        for r in range(n):
            tap[r], volts[r], sequence[r] = state.tap[row, r], state.relay_v[row, r], state.in_sequence[row, r]
        _direct(settings, band.target_v[row], band.half_band_v[row], acts, volts, tap, wanted)
        soonest, left = due_s[row, 0], left_s[row, 0]
        for r in range(n):
            counts = wanted[r] != 0.0 or sequence[r] != 0.0
            waited[r] = state.out_of_band_s[row, r] if counts or integrating else 0.0
            delay = settings.tap_delay_s[r] if sequence[r] != 0.0 else settings.delay_s[r]
            due_in[r] = max(delay - waited[r], 0.0) if counts else np.inf
            soonest = min(soonest, due_in[r])
        comes = soonest < left - SAME_TIME_S
        passed = soonest if comes else left
        for r in range(n):
            counts = wanted[r] != 0.0 or sequence[r] != 0.0
            over = comes and due_in[r] <= soonest + SAME_TIME_S
            turn = wanted[r] if over else 0.0
            tap[r] += turn
            waited[r] = 0.0 if over else waited[r] + passed if counts else max(waited[r] - passed, 0.0)
            if over:
                sequence[r] = abs(turn)
            since[r] = 0.0 if turn != 0.0 else state.since_s[row, r] + passed
            moved[r] = state.moved[row, r] + abs(turn)
            moves[r] = state.moves[row, r] + abs(turn)
            out[7, row, r] = passed
    return out
