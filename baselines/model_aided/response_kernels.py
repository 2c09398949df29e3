"""What each agent does, compiled: its estimate of all voltages, its clock and its best response (``decision``)."""

# pyright: basic
from __future__ import annotations

import numba
import numpy as np

_FAST = {"reassoc", "contract", "nnan", "ninf", "nsz"}
_TOP = 4.0  # beyond so many standard deviations an error does not come
# (Phi(x) - 1/2) / x in powers of x^2, fitted by least squares on [-4, 4].
_PHI = (
    0.3989380888, -0.06647037283, 0.009945140159, -0.001168552637, 0.000108470961, -7.84150478e-06, 4.224180292e-07,
    -1.57259613e-08, 3.56118286e-10, -3.65883123e-12,
)  # fmt: skip
_CLOSE = 1e-4  # share of a range at which a search ends
_MOST = 12  # steps of a search


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def decide(
    first, last, by_voltage, by_violation, band_pu, hold, alike, base, own_base, gain, inverse_spread, by_all,
    by_q, by_own, by_p, by_draw, waiting, level, weight, e_own, moved_kvar, more_kw, span_kw, p_kw, share, rest,
    s_rated, q_scale, effort, new, cut_kw, slope, relief, surprise,
):  # fmt: skip
    """Decide for the lanes from ``first`` to before ``last``, writing to ``new .. surprise``.

    Arrays are those of ``Commissioned`` (one placement, or one a lane) and ``Seen``, contiguous; ``level`` and
    ``weight`` say between which levels an agent is and how far.
    """
    n, n_node = by_q.shape[1], by_q.shape[2]
    e, inverse, together, own = np.empty(n_node), np.empty(n_node), np.empty(n_node), np.empty(n_node)
    for m in range(first, last):
        of = m if by_q.shape[0] > 1 else 0
        for i in range(n):
            at = level[m, i]
            to, part = min(at + 1, base.shape[2] - 1), weight[m, i]
            off, off_to = e_own[m, i] - own_base[of, i, at], e_own[m, i] - own_base[of, i, to]
            surprise[m, i] = (1.0 - part) * off + part * off_to
            up, down = moved_kvar[m, i], more_kw[m, i]
            for k in range(n_node):
                low_v = base[of, i, at, k] + gain[of, i, at, k] * off
                high_v = base[of, i, to, k] + gain[of, i, to, k] * off_to
                v = (1.0 - part) * low_v + part * high_v
                e[k] = v + up * by_q[of, i, k] - down * by_draw[of, i, k] - 1.0
                inverse[k] = (1.0 - part) * inverse_spread[of, i, at, k] + part * inverse_spread[of, i, to, k]
                together[k] = alike[of, i] * ((1.0 - part) * by_all[of, i, at, k] + part * by_all[of, i, to, k])
                own[k] = q_scale[i] * by_own[of, i, k]
            p_next = p_kw[m, i]
            if i < span_kw.shape[1]:
                cut, relief[m, i] = _cut(
                    e, inverse, by_draw[of, i], by_p[of, i], by_voltage, by_violation, band_pu, span_kw[m, i],
                    waiting[of, i],
                )  # fmt: skip
                cut_kw[m, i] = cut
                p_next -= cut
                for k in range(n_node):
                    e[k] += cut * by_draw[of, i, k]
            limit = 0.0
            if q_scale[i] > 0.0:
                limit = min(np.sqrt(max(s_rated[i] ** 2 - p_next**2, 0.0)) / q_scale[i], 1.0)
            new[m, i], slope[m, i] = respond(
                e, inverse, together, own, by_voltage, by_violation, band_pu, share[m, i], limit, effort[i],
                hold[of, i], rest[m, i],
            )  # fmt: skip
    return 0


@numba.njit(cache=True, error_model="numpy", fastmath=_FAST)
def half_normal(x):
    """Phi(x) - 1/2 within 4e-5, Phi the standard normal distribution."""
    x = min(max(x, -_TOP), _TOP)
    y = x * x
    high = _PHI[5] + y * (_PHI[6] + y * (_PHI[7] + y * (_PHI[8] + y * _PHI[9])))
    return x * (_PHI[0] + y * (_PHI[1] + y * (_PHI[2] + y * (_PHI[3] + y * (_PHI[4] + y * high)))))


@numba.njit(cache=True, error_model="numpy", fastmath=_FAST)
def _slope(e, inverse, direction, moved, by, by_voltage, by_violation, band_pu):
    """Derivative of the expected cost by what moves the voltages by ``by``, after a move along ``direction``."""
    total = 0.0
    for k in range(len(e)):
        x, b = (e[k] + moved * direction[k]) * inverse[k], band_pu * inverse[k]
        beyond = half_normal(x - b) + half_normal(x + b)
        total += by[k] * (2.0 * by_voltage * half_normal(x) + by_violation * beyond)
    return total


@numba.njit(cache=True, error_model="numpy", fastmath=_FAST)
def _zero(
    e, inverse, direction, by, by_voltage, by_violation, band_pu, constant, rise, low, low_f, high, high_f, close
):
    """Where ``constant + rise t + _slope(t)`` is 0 in (low, high), of other signs at its ends; the Illinois method."""
    side = 0
    for _ in range(_MOST):
        t = (low * high_f - high * low_f) / (high_f - low_f)
        f = constant + rise * t + _slope(e, inverse, direction, t, by, by_voltage, by_violation, band_pu)
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


@numba.njit(cache=True, error_model="numpy", fastmath=_FAST)
def _cut(e, inverse, by_draw, by_p, by_voltage, by_violation, band_pu, span_kw, waiting):
    """How much less than all work to serve, kW, until a kW less relieves no more than it costs to let it wait.

    The second figure is what the first kW relieves.
    """
    low_f = waiting + _slope(e, inverse, by_draw, 0.0, by_p, by_voltage, by_violation, band_pu)
    relief = waiting - low_f
    if low_f >= 0.0 or span_kw <= 0.0:
        return 0.0, relief
    high_f = waiting + _slope(e, inverse, by_draw, span_kw, by_p, by_voltage, by_violation, band_pu)
    if high_f <= 0.0:
        return span_kw, relief
    cut = _zero(
        e, inverse, by_draw, by_p, by_voltage, by_violation, band_pu, waiting, 0.0, 0.0, low_f, span_kw, high_f,
        _CLOSE * span_kw,
    )  # fmt: skip
    return cut, relief


@numba.njit(cache=True, error_model="numpy", fastmath=_FAST)
def respond(e, inverse, together, own, by_voltage, by_violation, band_pu, share, limit, effort, hold, rest):
    """The best setpoint as a share of the limit, and the slope at the one now without the price of effort."""
    constant = hold * (share - rest)
    now = constant + _slope(e, inverse, together, 0.0, own, by_voltage, by_violation, band_pu)
    if limit <= 0.0:
        return 0.0, now
    # The price of effort has its kink at 0, which the setpoint leaves only where the slope there is beyond it.
    idle = constant - hold * share + _slope(e, inverse, together, -share, own, by_voltage, by_violation, band_pu)
    if abs(idle) <= effort:
        return 0.0, now
    sign = 1.0 if idle < 0.0 else -1.0
    constant += sign * effort
    end = sign * limit - share
    end_f = constant + hold * end + _slope(e, inverse, together, end, own, by_voltage, by_violation, band_pu)
    if sign * end_f <= 0.0:
        return sign * limit, now
    low, low_f, high, high_f = -share, idle + sign * effort, end, end_f
    if sign < 0.0:
        low, low_f, high, high_f = high, high_f, low, low_f
    if low < 0.0 < high:
        here = now + sign * effort
        if here > 0.0:
            high, high_f = 0.0, here
        else:
            low, low_f = 0.0, here
    t = _zero(
        e, inverse, together, own, by_voltage, by_violation, band_pu, constant, hold, low, low_f, high, high_f,
        _CLOSE * limit,
    )  # fmt: skip
    return share + t, now
