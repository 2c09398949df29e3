"""Compiled form of ``datacenter.step`` under the linear clock law: one pass over the sites where NumPy makes ten."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled


@compiled
def serve_linearly(p_idle_kw, p_dynamic_kw, f_max_mhz, backlog_kws, p_ref_kw, f_mhz, dt_s, boost):
    """Backlog, kW s, work arrived and served, and draw, kW, (row, slot) each, with the bits of the array form."""
    queued, arrived, served, p_kw = (
        np.empty_like(p_ref_kw), np.empty_like(p_ref_kw), np.empty_like(p_ref_kw), np.empty_like(p_ref_kw),
    )  # fmt: skip
    for row in range(p_ref_kw.shape[0]):
        for i in range(p_ref_kw.shape[1]):
            ref, idle, most = p_ref_kw[row, i], p_idle_kw[i], p_dynamic_kw[i]
            a = ref - idle
            a = 0.0 if a < 0.0 else a
            if boost and a > most:
                most = a
            done, at_hand = most * (f_mhz[row, i] / f_max_mhz[i]), a + backlog_kws[row, i] / dt_s
            done = at_hand if at_hand < done else done
            left = backlog_kws[row, i] + (a - done) * dt_s
            arrived[row, i], served[row, i] = a, done
            queued[row, i] = 0.0 if left < 0.0 else left
            p_kw[row, i] = (idle if idle < ref else ref) + done
    return queued, arrived, served, p_kw
