"""The compiled forms of ``connection.advance`` and ``counters``, with the bits of the array forms."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.devices.ride_through.rules import ALL_BACK


@compiled(inner=True)
def _note(ages_s, age_s, window_s):
    """Put a new age in front of the others, and say whether the oldest then lies within the window."""
    n = ages_s.shape[0]
    for k in range(n - 1, 0, -1):
        ages_s[k] = ages_s[k - 1]
    if n > 0:
        ages_s[0] = age_s
    return n > 0 and ages_s[n - 1] <= window_s


@compiled
def advance_rows(before, low, high, sags, pace, figures, widths, dt_s):
    """The fields of ``ConnectionState`` after an interval, ``lost_kw`` 0; ``widths`` are for tensors."""
    threshold, time_s, delay_s, release_s, n_under, longest_s, remembered_s, window_s = figures
    share_in, timer_in, wait_in, locked_in = before.share, before.timer_s, before.wait_s, before.locked
    events_in, returns_in = before.event_age_s, before.return_age_s
    in_step = np.empty((len(share_in), 0, 3)) if sags is None else sags
    n_row, slots = share_in.shape
    share, wait, locked = np.empty_like(share_in), np.empty_like(share_in), np.empty_like(share_in)
    tripped, lost = np.empty_like(share_in), np.zeros_like(share_in)
    timer, events, returns = np.empty_like(timer_in), np.empty_like(events_in), np.empty_like(returns_in)
    soon = 1e-3 * dt_s
    for i in range(n_row):
        for j in range(slots):
            connected, out_of_order, event = share_in[i, j] > 0.0, False, False
            for k in range(threshold.shape[1]):
                v = low[i, j] if k < n_under else -high[i, j]
                timer[i, j, k] = 0.0
                if v < threshold[j, k]:
                    out_of_order = True
                    timer[i, j, k] = timer_in[i, j, k] + dt_s
                    event = event or (connected and timer[i, j, k] + soon >= time_s[j, k])
            may_go, was_locked = pace[i, j] > 0.0 and not out_of_order, locked_in[i, j] > 0.0
            released = was_locked and wait_in[i, j] + soon >= release_s[j] and may_go
            is_locked = was_locked and not released
            for k in range(events.shape[2]):
                aged = events_in[i, j, k] + dt_s
                events[i, j, k] = remembered_s if released or aged > remembered_s else aged
            since = 0.0 if out_of_order else wait_in[i, j] + dt_s
            if event:
                since = dt_s
                is_locked = _note(events[i, j], dt_s, window_s) or is_locked
            for s in range(in_step.shape[1]):
                duration_s, retained, rest_s = in_step[i, s, 0], in_step[i, s, 1], in_step[i, s, 2]
                fell = False
                for k in range(threshold.shape[1] if duration_s > 0.0 else 0):
                    v = low[i, j] if k < n_under else -high[i, j]
                    fell = fell or (v * retained < threshold[j, k] and timer[i, j, k] + duration_s > time_s[j, k])
                if fell:
                    event, since = True, rest_s
                    is_locked = _note(events[i, j], rest_s, window_s) or is_locked
            for k in range(returns.shape[2]):
                returns[i, j, k] = min(returns_in[i, j, k] + dt_s, remembered_s)
            waited = wait_in[i, j] + soon >= (0.0 if released else delay_s[j])
            allowed = returns.shape[2] == 0 or returns[i, j, returns.shape[2] - 1] >= 60.0
            start = not connected and not event and not is_locked and waited and may_go and allowed
            if start:
                _note(returns[i, j], 0.0, 0.0)
            present = (connected or start) and not event
            grown = share_in[i, j] + pace[i, j]
            share[i, j] = 0.0 if not present else 1.0 if grown > ALL_BACK else grown
            wait[i, j] = min(since, longest_s)
            locked[i, j] = 1.0 if is_locked else 0.0
            tripped[i, j] = 1.0 if event and connected else 0.0
    return share, timer, wait, events, returns, locked, tripped, lost


@compiled
def counted(state, figures):
    """See ``connection.counters``."""
    rows, slots, n_element = state.timer_s.shape
    out = np.zeros((3, rows, slots))  # one array, because each that a kernel returns takes time
    events, returns, largest = out[0], out[1], out[2]
    for i in range(rows):
        for j in range(slots):
            for k in range(n_element):
                if state.timer_s[i, j, k] > 0.0:
                    largest[i, j] = max(largest[i, j], state.timer_s[i, j, k] / (figures.time_s[j, k] + 1e-9))
            largest[i, j] = min(largest[i, j], 1.0)
            for k in range(state.event_age_s.shape[2]):
                events[i, j] += state.event_age_s[i, j, k] < figures.window_s
            for k in range(state.return_age_s.shape[2]):
                returns[i, j] += state.return_age_s[i, j, k] < 60.0
    return out
