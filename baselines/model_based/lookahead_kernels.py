"""The rounds of ``lookahead``'s solver, compiled: one row after the other, its iterate in the cache throughout."""

# pyright: basic
from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled


@compiled(nogil=True, fastmath={"reassoc", "contract"})
def rounds(
    first, last, count, relaxation, band_pu, by, by_more, kinks, rises, offset, slopes, base, low, high, s_rated,
    q_high, work, price, effort, w_e, w_y, w_b, over_time, inverse, sites, share, e, y, b, u_e, u_y, u_b,
):  # fmt: skip
    """Do ``count`` rounds of the rows from ``first`` to before ``last``, writing to the iterate ``e .. u_b``.

    Arrays are those of ``Program``, ``_System`` and ``Iterate``, contiguous, and ``kinks`` and ``rises`` those of
    ``lookahead._kinks``. ``price`` (row, step, n_dc), ``effort`` (row, n_agent), and the weights ``by`` of a deviation
    and ``by_more`` of its excess are divided by the penalties.
    """
    for row in range(first, last):
        _row(
            count, relaxation, band_pu, by, by_more, kinks, rises, offset[row], slopes[row], base[row], low[row],
            high[row], s_rated[row], q_high[row], work[row], price[row], effort[row], w_e, w_y[row], w_b[row],
            over_time, inverse[row], sites[row], share[row], e[row], y[row], b[row], u_e[row], u_y[row], u_b[row],
        )  # fmt: skip
    return 0


@compiled(fastmath={"reassoc", "contract"})
def _row(
    count, relaxation, band_pu, by, by_more, kinks, rises, offset, slopes, base, low, high, s_rated, q_high, work,
    price, effort, w_e, w_y, w_b, over_time, inverse, sites, share, e, y, b, u_e, u_y, u_b,
):  # fmt: skip
    """The rounds of one row; arrays as above without the row."""
    steps, n_bus = offset.shape
    n, n_dc = slopes.shape[0], base.shape[1]
    kept = 1.0 - relaxation
    right, modes, x = np.empty((n, steps)), np.empty((n, steps)), np.empty((n, steps))
    time_over = np.ascontiguousarray(over_time.T)
    line, of_sites, waits = np.empty(n_bus), np.empty(n_dc), np.empty(n_dc)
    for k in range(steps):
        for m in range(n_bus):
            line[m] = e[k, m] - u_e[k, m] - offset[k, m]
        _bus_terms(k, w_e, slopes, line, right)
    for _ in range(count):
        waits[:] = 0.0
        for k in range(steps - 1, -1, -1):
            for i in range(n):
                right[i, k] += w_y[i] * (y[k, i] - u_y[k, i])
            for i in range(n_dc):
                waits[i] += w_b[i] * (work[k, i] - b[k, i] + u_b[k, i])
                right[i, k] += waits[i]
        _over_modes(over_time, time_over, inverse, sites, share, right, modes, of_sites, x)
        waits[:] = 0.0
        for k in range(steps):
            _bus_step(k, relaxation, kept, band_pu, by, by_more, kinks, rises, offset, slopes, x, e, u_e, line)
            _bus_terms(k, w_e, slopes, line, right)
            for i in range(n):
                u_y[k, i] += relaxation * x[i, k] + kept * y[k, i]
            _within(k, base, low, high, s_rated, q_high, effort, u_y, y)
            for i in range(n_dc):
                waits[i] += x[i, k]
                to = relaxation * (work[k, i] - waits[i]) + kept * b[k, i] + u_b[k, i]
                new = max(to - price[k, i], 0.0)
                b[k, i] = new
                u_b[k, i] = to - new


@compiled(inner=True)
def _at_kinks(k, relaxation, kept, steepest, kinks, rises, offset, e, u_e, line):
    """The same for deviations in ``line`` whose cost has these kinks and rises of slope, and begins at -steepest."""
    for m in range(len(kinks)):
        to = relaxation * line[m] + kept * e[k, m] + u_e[k, m]
        slope = -steepest
        new = to - slope
        for j in range(kinks.shape[1]):
            if new <= kinks[m, j]:
                break
            slope += rises[m, j]
            new = max(to - slope, kinks[m, j])
        e[k, m] = new
        u_e[k, m] = to - new
        line[m] = new - (to - new) - offset[k, m]


@compiled(inner=True, fastmath={"reassoc", "contract"})
def _bus_step(k, relaxation, kept, band_pu, by, by_more, kinks, rises, offset, slopes, x, e, u_e, line):
    """The deviations of a step and their multipliers after a round, and into ``line`` what the next one begins from."""
    n, n_bus = slopes.shape
    for m in range(n_bus):
        line[m] = offset[k, m]
    for i in range(n):
        power = x[i, k]
        for m in range(n_bus):
            line[m] += power * slopes[i, m]
    if len(kinks):
        _at_kinks(k, relaxation, kept, by + by_more, kinks, rises, offset, e, u_e, line)
        return
    for m in range(n_bus):
        to = relaxation * line[m] + kept * e[k, m] + u_e[k, m]
        size = max(abs(to) - by, 0.0)
        new = np.copysign(min(size, max(size - by_more, band_pu)), to)
        e[k, m] = new
        u_e[k, m] = to - new
        line[m] = new - (to - new) - offset[k, m]


@compiled(inner=True, fastmath={"reassoc", "contract"})
def _bus_terms(k, w_e, slopes, line, right):
    """The buses' part of the right-hand side of a step, into ``right``."""
    n, n_bus = slopes.shape
    for i in range(n):
        total = 0.0
        for m in range(n_bus):
            total += line[m] * slopes[i, m]
        right[i, k] = w_e * total


@compiled(inner=True, fastmath={"reassoc", "contract"})
def _over_modes(over_time, time_over, inverse, sites, share, right, modes, of_sites, x):
    """Solve the least-squares problem for ``right`` (n, step), into ``x``; see ``_System``."""
    n, steps = right.shape
    n_dc = sites.shape[1]
    for i in range(n):
        for k in range(steps):
            total = 0.0
            for j in range(steps):
                total += time_over[k, j] * right[i, j]
            modes[i, k] = total
    for k in range(steps):
        for j in range(n_dc):
            total = 0.0
            for i in range(n):
                total += modes[i, k] * sites[i, j]
            of_sites[j] = total * share[k, j]
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += modes[j, k] * inverse[j, i]
            for j in range(n_dc):
                total -= of_sites[j] * sites[i, j]
            right[i, k] = total
    for i in range(n):
        for k in range(steps):
            total = 0.0
            for j in range(steps):
                total += over_time[k, j] * right[i, j]
            x[i, k] = total


@compiled(inner=True)
def _within(k, base, low, high, s_rated, q_high, effort, u_y, y):
    """Proximal point of effort |q| within box and circle of what stands in ``u_y``, into ``y``; ``u_y`` is the rest."""
    n_dc, n_agent = base.shape[1], q_high.shape[0]
    for a in range(n_agent):
        q_to = u_y[k, n_dc + a]
        pulled = max(abs(q_to) - effort[a], 0.0)
        size = min(pulled, q_high[a])
        if a < n_dc:
            to, p_base = u_y[k, a], base[k, a]
            d = min(max(to, low[k, a]), high[k, a])
            s, p_own = s_rated[k, a], p_base + d
            if p_own * p_own + size * size > s * s:
                # A corner of the box is outside the circle: the nearest point is on the arc, or at an end of it in
                # the box.
                p_to, q_top = p_base + to, q_high[a]
                p_arc = p_to * s / max(np.sqrt(p_to * p_to + pulled * pulled), 1e-12)
                p_arc = max(p_arc, np.sqrt(max(s * s - q_top * q_top, 0.0)))
                p_arc = min(max(p_arc, p_base + low[k, a]), p_base + high[k, a])
                d = p_arc - p_base
                size = min(np.sqrt(max(s * s - p_arc * p_arc, 0.0)), q_top)
            y[k, a] = d
            u_y[k, a] = to - d
        new = np.copysign(size, q_to)
        y[k, n_dc + a] = new
        u_y[k, n_dc + a] = q_to - new
