"""Payment of agents for taps that relays will make, as a part of difference rewards.

The timers of relays run over many steps, so the tap that an action leads to comes later. As deferred work is charged at
once, a step is paid at once for its share of the value of the coming tap:

    saved(a) = sum over relays of value dt/delay (s(x) - s(x'))    value = max(saving T_left - price, 0)
    x        = (d / half band - 1 - MARGIN) / WIDTH                s(x)  = min(exp(x), 1)

A dash marks the step with the default in an entry. The distance d of the relay volts from the target is positive on the
side of the useful tap. It follows the action by the slopes of the relay volts, with line-drop compensation. T_left are
the steps left, and ``price`` is the cost of a tap. ``saving`` is the cost that the tap saves in each later step. It
assumes that all agents then choose their reactive power for this tap (``tap_targets``).

A timer advances only out of band. A single agent hardly ever moves a relay out of its band, so ``s`` is a smooth form
of this condition. It ends a margin beyond the band, because a relay at the edge is in and out of band in turn.

This is biased: it pays for an expected tap, pays each regulator for one tap of an episode at most and in one
direction, and neglects that timers count down in band. Taps that do not save their price are assigned to no agent.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env.engine.physics.acting_relays import scenario_relays
from dcgrid_env.engine.physics.state import State
from dcgrid_env.scenario.scenario import Scenario

MARGIN = 0.2
"""Distance beyond the band up to which volts are paid, as a share of half the band."""
WIDTH = 0.8
"""Width of the smooth condition as a share of half the band."""


class TapTargets(NamedTuple):
    """Useful taps of R regulators."""

    rows: np.ndarray
    """Their rows in the table of regulators, int, (R,)."""
    direction: np.ndarray
    """1 for a tap up, -1 for one down, (R,)."""
    saving: np.ndarray
    """Cost that the tap saves in each later step, (R,)."""
    price: float
    """Cost of a tap, in units of the cost of a step."""
    by_p: np.ndarray
    """Change of ``ComingTaps.off_v`` per kW injected at each group of nodes of ``connections``, (n_group, R)."""
    by_q: np.ndarray
    """Change of ``ComingTaps.off_v`` per kvar injected, (n_group, R)."""


class ComingTaps(NamedTuple):
    """Worth of useful taps after a step."""

    off_v: np.ndarray
    """Distance of the relay volts from the target, positive on the side of the useful tap, V, (row, R)."""
    half_band_v: np.ndarray
    """Half of the band, V, (R,)."""
    worth: np.ndarray
    """Payment for a step in which the timer advances, (row, R)."""


def coming_taps(
    scenario: Scenario, targets: TapTargets, state: State, steps_left: np.ndarray, offset_v: np.ndarray | None
) -> ComingTaps:
    """Return the worth of useful taps.

    Parameters
    ----------
    scenario, targets
        The scenario and its useful taps.
    state
        State after the step.
    steps_left
        Steps of the episode after this one, (row,).
    offset_v
        Offsets of set points by schedules, V, (row, n_regulator); None without schedules.
    """
    settings, rows = scenario_relays(scenario), targets.rows
    regulators = state.three_phase.equipment.regulators  # pyright: ignore[reportOptionalMemberAccess]
    tap, relay_v, in_sequence, moves = (
        getattr(regulators, name)[:, rows] for name in ("tap", "relay_v", "in_sequence", "moves")
    )
    target_v = settings.target_v[rows] if offset_v is None else settings.target_v[rows] + offset_v[:, rows]
    is_due = (moves == 0.0) & np.where(
        targets.direction > 0.0, tap < settings.highest[rows], tap > settings.lowest[rows]
    )
    value = np.maximum(targets.saving * steps_left[:, None] - targets.price, 0.0) * is_due
    delay_s = np.where(in_sequence > 0.0, settings.tap_delay_s[rows], settings.delay_s[rows])
    worth = value * np.minimum(scenario.dt_s / np.maximum(delay_s, scenario.dt_s), 1.0)
    off_v = np.ascontiguousarray(targets.direction * (target_v - relay_v))
    return ComingTaps(off_v, settings.half_band_v[rows], np.ascontiguousarray(worth))
