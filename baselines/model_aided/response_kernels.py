"""What each agent does, compiled: its estimate of all voltages, its clock and its best response (``decision``)."""

# pyright: basic
from __future__ import annotations

import math

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.devices import converter

reactive_limit = converter.limit.scalar
_FAST = {"reassoc", "contract", "nnan", "ninf", "nsz"}
_TOP = 4.0  # beyond so many standard deviations an error does not come
# (Phi(x) - 1/2) / x in powers of x^2, fitted by least squares on [-4, 4].
_PHI = (
    0.3989380888, -0.06647037283, 0.009945140159, -0.001168552637, 0.000108470961, -7.84150478e-06, 4.224180292e-07,
    -1.57259613e-08, 3.56118286e-10, -3.65883123e-12,
)  # fmt: skip
_END = _TOP * sum(c * _TOP ** (2 * i) for i, c in enumerate(_PHI))  # what half_normal is there
_CLOSE = 1e-4  # share of a range at which a search ends
_MOST = 12  # steps of a search
_ROUNDING = 1e-12  # share of a limit
_VECTOR = 8  # numbers that a processor takes at once; what is left of a row beyond a multiple takes as long again


@compiled(nogil=True, fastmath=_FAST)
def decide(
    first, last, by_voltage, by_violation, band_pu, hold, alike, base, own_base, gain, inverse_spread, by_all,
    by_q, by_own, by_p, by_draw, waiting, level, weight, e_own, moved_kvar, more_kw, span_kw, p_kw, share, rest,
    s_rated, q_scale, effort, new, cut_kw, slope, relief, surprise,
):  # fmt: skip
    """Decide for the rows from ``first`` to before ``last``, writing to ``new .. surprise``.

    Arrays are those of ``Commissioned`` (one placement, or one a row) and ``DecisionInputs``, contiguous; ``level`` and
    ``weight`` say between which levels an agent is and how far. Without columns in ``span_kw`` no clock is decided.
    """
    n, n_node, top = by_q.shape[1], by_q.shape[2], base.shape[2] - 1
    each_row = by_q.shape[0] > 1 or top > 0
    price = (by_voltage, by_violation)
    rows = np.zeros((7, -(-n_node // _VECTOR) * _VECTOR))
    # In standard deviations of each voltage: how far it is from 1 p.u., the band, what all agents and the draw move.
    x, edge, together, drawn = rows[0], rows[1], rows[2], rows[3]
    inverse, effect, own_p = rows[4], rows[5], rows[6]
    apart = rises = False
    for i in range(n):
        for m in range(first, last):
            place = m if by_q.shape[0] > 1 else 0
            below = level[m, i]
            to, part = min(below + 1, top), weight[m, i]
            q, d = by_q[place, i], by_draw[place, i]
            if each_row or m == first:
                spread, spread_to = inverse_spread[place, i, below], inverse_spread[place, i, to]
                limits, limits_to = by_all[place, i, below], by_all[place, i, to]
                least, steepest_fall = np.inf, 0.0
                for k in range(n_node):
                    inverse[k] = (1.0 - part) * spread[k] + part * spread_to[k]
                    edge[k] = band_pu * inverse[k]
                    together[k] = alike[place, i] * ((1.0 - part) * limits[k] + part * limits_to[k]) * inverse[k]
                    drawn[k] = d[k] * inverse[k]
                    effect[k] = q_scale[i] * by_own[place, i, k]
                    own_p[k] = by_p[place, i, k]
                    least = min(least, edge[k])
                    steepest_fall = min(steepest_fall, together[k] * effect[k])
                apart, rises = least >= 2.0 * _TOP, steepest_fall == 0.0
            off, off_to = e_own[m, i] - own_base[place, i, below], e_own[m, i] - own_base[place, i, to]
            surprise[m, i] = (1.0 - part) * off + part * off_to
            up, down = moved_kvar[m, i], more_kw[m, i]
            mean, gains = base[place, i, below], gain[place, i, below]
            mean_to, gains_to = base[place, i, to], gain[place, i, to]
            for k in range(n_node):
                v = mean[k] + gains[k] * off
                if part > 0.0:
                    v = (1.0 - part) * v + part * (mean_to[k] + gains_to[k] * off_to)
                x[k] = (v + up * q[k] - down * d[k] - 1.0) * inverse[k]
            p_next = p_kw[m, i]
            if i < span_kw.shape[1]:
                cut, relief[m, i] = _cut(x, edge, apart, drawn, own_p, price, span_kw[m, i], waiting[place, i])
                cut_kw[m, i] = cut
                p_next -= cut
                for k in range(n_node):
                    x[k] += cut * drawn[k]
            limit = 0.0
            if q_scale[i] > 0.0:
                limit = reactive_limit(s_rated[i], q_scale[i], p_next) / q_scale[i]
            new[m, i], slope[m, i] = respond(
                x,
                edge,
                apart,
                rises,
                together,
                effect,
                price,
                share[m, i],
                limit,
                effort[i],
                hold[place, i],
                rest[m, i],
            )
    return 0


@compiled(fastmath=_FAST)
def half_normal(x):
    """Phi(x) - 1/2 within 4e-5, Phi the standard normal distribution."""
    x = min(max(x, -_TOP), _TOP)
    y = x * x
    high = _PHI[5] + y * (_PHI[6] + y * (_PHI[7] + y * (_PHI[8] + y * _PHI[9])))
    return x * (_PHI[0] + y * (_PHI[1] + y * (_PHI[2] + y * (_PHI[3] + y * (_PHI[4] + y * high)))))


@compiled(inner=True, fastmath=_FAST, forceinline=True)
def _slope(x, edge, apart, direction, moved, by, price):
    """Derivative of the expected cost by what moves the voltages by ``by``, after a move along ``direction``.

    If ``apart``, the band's edges are so far apart that only one of the three kinks matters at each bus. Then one
    normal distribution per bus is enough.
    """
    by_voltage, by_violation = price
    total = 0.0
    if apart:
        for k in range(len(x)):
            deviation = x[k] + moved * direction[k]
            size = abs(deviation)
            near = size < _TOP
            h = half_normal(size - (0.0 if near else edge[k]))
            beyond = (2.0 * by_voltage + by_violation) * _END + by_violation * h
            total += by[k] * math.copysign(2.0 * by_voltage * h if near else beyond, deviation)
    else:
        for k in range(len(x)):
            deviation = x[k] + moved * direction[k]
            beyond = half_normal(deviation - edge[k]) + half_normal(deviation + edge[k])
            total += by[k] * (2.0 * by_voltage * half_normal(deviation) + by_violation * beyond)
    return total


@compiled(inner=True, fastmath=_FAST)
def _zero(x, edge, apart, direction, by, price, constant, rise, low, low_f, high, high_f, close):
    """Find the zero of ``constant + rise t + _slope(t)`` in (low, high), with a change of sign; the Illinois method."""
    side = 0
    for _ in range(_MOST):
        t = (low * high_f - high * low_f) / (high_f - low_f)
        f = constant + rise * t + _slope(x, edge, apart, direction, t, by, price)
        if f > 0.0:
            moved = high - t
            high, high_f = t, f
            if side > 0:
                low_f *= 0.5
            side = 1
        else:
            moved = t - low
            low, low_f = t, f
            if side < 0:
                high_f *= 0.5
            side = -1
        if min(moved, high - low) < close:
            return t
    return 0.5 * (low + high)


@compiled(inner=True, fastmath=_FAST)
def _cut(x, edge, apart, drawn, by_p, price, span_kw, waiting):
    """How much less than all work to serve, kW, until a kW less relieves no more than it costs to let it wait.

    The second figure is the relief by the first kW.
    """
    low_f = waiting + _slope(x, edge, apart, drawn, 0.0, by_p, price)
    relief = waiting - low_f
    if low_f >= 0.0 or span_kw <= 0.0:
        return 0.0, relief
    high_f = waiting + _slope(x, edge, apart, drawn, span_kw, by_p, price)
    if high_f <= 0.0:
        return span_kw, relief
    close = _CLOSE * span_kw
    cut = _zero(x, edge, apart, drawn, by_p, price, waiting, 0.0, 0.0, low_f, span_kw, high_f, close)
    return cut, relief


@compiled(fastmath=_FAST)
def respond(x, edge, apart, rises, together, effect, price, share, limit, effort, hold, rest):
    """The best setpoint as a share of the limit, and the slope at the one now without the price of effort.

    The slope ``rises`` along the setpoint if no agent raises a voltage that another lowers. Then its sign at the
    present setpoint gives the side of the best one, and the other side is skipped.
    """
    constant = hold * (share - rest)
    now = constant + _slope(x, edge, apart, together, 0.0, effect, price)
    if limit <= 0.0:
        return 0.0, now
    sign = 1.0 if share > 0.0 else -1.0
    begin, begin_f = 0.0, now + sign * effort
    further = rises and share != 0.0 and sign * begin_f < 0.0
    if not further:
        # The price of effort has its kink at 0, which the setpoint leaves only where the slope there is beyond it.
        idle = now
        if share != 0.0:
            idle = constant - hold * share + _slope(x, edge, apart, together, -share, effect, price)
        if abs(idle) <= effort:
            return 0.0, now
        sign = 1.0 if idle < 0.0 else -1.0
        begin, begin_f = -share, idle + sign * effort
    constant += sign * effort
    end, middle = sign * limit - share, now + sign * effort
    if further and sign * end <= _ROUNDING * limit:
        return sign * limit, now
    between = sign * begin < 0.0 < sign * end
    if between and rises and sign * middle > 0.0:
        end, end_f = 0.0, middle
    else:
        end_f = constant + hold * end + _slope(x, edge, apart, together, end, effect, price)
        if sign * end_f <= 0.0:
            return sign * limit, now
        if between and sign * middle > 0.0:
            end, end_f = 0.0, middle
        elif between:
            begin, begin_f = 0.0, middle
    low, low_f, high, high_f = begin, begin_f, end, end_f
    if sign < 0.0:
        low, low_f, high, high_f = end, end_f, begin, begin_f
    t = _zero(x, edge, apart, together, effect, price, constant, hold, low, low_f, high, high_f, _CLOSE * limit)
    return share + t, now
