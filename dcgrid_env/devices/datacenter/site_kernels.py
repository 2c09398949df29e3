# pyright: reportUnknownParameterType=false, reportMissingParameterType=false, reportUnknownVariableType=false
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false
"""The compiled form of what ``service_levels`` does, one pass over the sites.

Numba's functions have no types to check.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled


@compiled
def serve_by_slack(queue_kws, moved_kw, arrived_kw, served_kw, dt_s, soon, later, share, by_deadline):
    """See ``service_levels.serve_by_slack``."""
    n_row, slots = arrived_kw.shape
    queue = np.empty((n_row, slots, later + 1))
    due = np.empty((2, n_row, slots))
    at_soon = soon + 1 if by_deadline else later + 1
    for row in range(n_row):
        for i in range(slots):
            moved = moved_kw[row, i] * dt_s if moved_kw is not None else 0.0
            local_kws, left_kws = arrived_kw[row, i] * dt_s - moved, served_kw[row, i] * dt_s
            carried, young_old = 0.0, 0.0
            for j in range(later + 2):
                x = queue_kws[row, i, j] if j <= later else 0.0
                if j == at_soon:
                    x += local_kws * share
                if j == later + 1:
                    x += local_kws * (1.0 - share)
                if j == max(at_soon - 1, 1):
                    x += moved * share
                if j == later:
                    x += moved * (1.0 - share)
                done = x if x < left_kws else left_kws
                x, left_kws = x - done, left_kws - done
                if j == 0:
                    carried = x
                elif j == 1:
                    queue[row, i, 0] = carried + x
                else:
                    queue[row, i, j - 1] = x
            if by_deadline:
                due[0, row, i], due[1, row, i] = queue[row, i, 0], queue[row, i, 1]
            else:
                old = later - soon
                for j in range(old + 1):
                    young_old += queue[row, i, j]
                due[0, row, i] = (1.0 - share) * queue[row, i, 0] + share * young_old
                after = queue[row, i, old + 1] if old + 1 <= later else 0.0
                due[1, row, i] = (1.0 - share) * queue[row, i, 1] + share * after
    return queue, due[0], due[1]
