"""Set points that agents request and a control takes over from time to time.

A request replaces the set point in force at the beginning of a step, provided that this has been in force for
``hold_s``. Until then the agent's action is ignored. A request within ``same`` of the set point in force does not
change it. At t = 0 the first change may be made at once.
"""

from __future__ import annotations

from dcgrid_env.core.arrays import Array, namespace

SHORTEST_HOLD_S = 60.0
"""Least time for which a set point is in force, s."""
_SAME_TIME_S = 1e-6


def in_force(
    requested: tuple[Array, Array], before: tuple[Array, Array], age_s: Array, hold_s: Array, same: float, dt_s: float
) -> tuple[Array, Array, Array]:
    """Return the set point in force over a step, its two parts, and the time since its last change at the end.

    Parameters
    ----------
    asked, before
        The set points requested and in force before, two parts of (row, slot) each.
    age_s
        Time since the last change before the step, s, (row, slot).
    hold_s
        Least time between changes, s, (slot,).
    same
        Largest difference that is ignored, in the unit of the parts.
    dt_s
        Length of the step, s.
    """
    xp = namespace(age_s)
    differs = (xp.abs(requested[0] - before[0]) > same) | (xp.abs(requested[1] - before[1]) > same)
    changes = differs & (age_s >= hold_s - _SAME_TIME_S)
    first, second = (xp.where(changes, new, old) for new, old in zip(requested, before, strict=True))
    return first, second, xp.where(changes, 0.0 * age_s, age_s) + dt_s


def observed_age(age_s: Array, hold_s: Array) -> Array:
    """Time since the last change as observed, s: ``hold_s`` once a change may be made."""
    return namespace(age_s).minimum(age_s, hold_s + 0.0 * age_s)
