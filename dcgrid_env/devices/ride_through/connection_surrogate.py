"""A derivative for disconnection and reconnection: exact values, with the slopes of smooth steps.

The connection of a device is a step function, whose derivative is 0 nearly everywhere. Gradient-based training can use
the derivative of a smooth surrogate instead (straight-through: Y. Bengio et al., "Estimating or propagating gradients
through stochastic neurons for conditional computation", arXiv 1308.3432). The terms added here to a state are 0 in
value, so every figure remains exact. They have these slopes:

    beyond a threshold      b = S((threshold - v) / v_pu)            of the voltage; its timer b (timer + dt)
    trips slowly            b S((timer + dt - time) / time_s)        of both
    trips in a sag          the share that is on the grid            of that share, so that staying away avoids it
    returns                 S(rate / (rate_share fastest))           of the channel ``return``, where it may return
    is back as a whole      1                                        of the share before, as having returned lasts

with S(x) = 1 / (1 + exp(-x)). Lock-outs, counters and the delays before a return have no derivative.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from dcgrid_env.core.arrays import Array, namespace
from dcgrid_env.core.checked import FieldError, finite


class TripWidths(NamedTuple):
    """How wide the smooth steps are; a step has most of its slope within four times that."""

    v_pu: float = 0.01
    """Width of the step at a threshold, p.u."""
    time_s: float = 1.0
    """Width of the step at the time to a slow trip, s."""
    rate_share: float = 0.3
    """Width of the step between what is to stay away and what to return, as a share of the fastest return."""

    def check(self) -> None:
        """Raise FieldError for a width that is not above 0."""
        for name, width in self._asdict().items():
            if not finite(width, 1e-9, 1e9):
                raise FieldError("TripWidths", name, width, "give a finite number above 0")


_NEVER_S = 1e6


def no_value(term: Array) -> Array:
    """0 with the derivative of ``term``."""
    return term - term.detach()


def smooth_step(x: Array, width: float) -> Array:
    """S(x / width), elementwise; far from the step, where it is flat, without overflow."""
    xp = namespace(x)
    return 1.0 / (1.0 + xp.exp(-xp.clip(x / width, -30.0, 30.0)))


def softplus(x: Array, width: float) -> Array:
    """The integral of S(x / width), elementwise."""
    xp = namespace(x)
    return xp.where(x > 30.0 * width, x, width * xp.log(1.0 + xp.exp(xp.clip(x / width, -30.0, 30.0))))


def smoothed_pace(pace: Array, rate: Array, fastest: float, dt_s: float, widths: TripWidths) -> Array:
    """The pace of a return with a derivative by the rate that asks for it, share/s, on both sides of 0: that of a
    softplus of this width."""
    width = widths.rate_share * fastest
    return pace.detach() + no_value(softplus(rate, width) * dt_s)


def with_derivatives(
    before: Any, after: Any, v: Array, threshold: Array, time_s: Array, fell: Array, may_return: Array, pace: Array,
    dt_s: float, widths: TripWidths,
) -> Any:  # fmt: skip
    """Return the exact state after an interval with the derivatives of the surrogate.

    Parameters
    ----------
    before, after
        States (``connection.ConnectionState``) at the beginning and the end.
    v, threshold, time_s
        The voltage that each element compares with its threshold, p.u., and the time that must pass before it trips,
        (row, slot, n_element).
    fell
        Whether a sag of the interval was not ridden through, bool, (row, slot).
    may_return
        Whether a disconnected device could reconnect in the interval on request, bool, (row, slot).
    pace
        Share of the power that a device may resume, (row, slot) or one number.
    dt_s
        Length of the interval, s.
    widths
        Widths of its smooth steps.
    """
    xp = namespace(v)
    beyond = smooth_step(threshold - v, widths.v_pu)
    timer_s = before.timer_s + dt_s
    spent_s = timer_s - xp.where(time_s < _NEVER_S, time_s, 0.0 * time_s + _NEVER_S)
    stays = (1.0 - beyond * smooth_step(spent_s, widths.time_s)).prod(-1)
    present, out = (xp.astype(flag, v.dtype) for flag in (before.share > 0.0, fell))
    kept = present * (1.0 - out) * before.share.detach() * no_value(stays)
    whole = xp.astype((after.share >= 1.0) & (before.share > 0.0), v.dtype) * no_value(before.share)
    back = xp.astype(may_return & (after.share <= 0.0), v.dtype) * no_value(before.share + pace)
    tripped = out * before.share + (1.0 - out) * present * (1.0 - stays)
    return after._replace(
        share=after.share + kept + whole + back,
        timer_s=after.timer_s.detach() + no_value(beyond * timer_s),
        tripped=after.tripped + no_value(tripped),
    )
