"""Settled taps of controlled regulators under constant loads.

Round by round the power flow is solved, and of the regulators out of band those with the shortest delay move a tap. It
ends where nothing moves; or where taps come back that have been before, which no further round would leave.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, as_like, min_last, namespace, put_rows
from dcgrid_env.devices.tap_changer.relay import RelaySettings, direction, relay_settings, relay_volts, settings_like
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.powerflow import Control, solve_unbalanced
from dcgrid_env.powerflow.unbalanced.three_phase_solution import ThreePhaseSolution

MOST_ROUNDS = 1000
Move = Callable[[RelaySettings, Array], Array]
"""How many taps a regulator out of band makes in a round, from its settings and the volts that it lacks."""


class SettledTaps(NamedTuple):
    """Settled taps, and whether they have settled; arrays of the loads' leading shape."""

    tap: Array
    """(row, n_regulator)."""
    settled: Array
    """Whether nothing moves any more, bool, (row,); False too where the power flow has no solution."""
    rounds: int
    """Power flows done, of the row that took the most."""


def one_tap(settings: RelaySettings, missing_v: Array) -> Array:
    """One tap in a round, whatever is lacking."""
    return 0.0 * missing_v + 1.0


def settled_taps(
    feeder: ThreePhaseFeeder,
    p_kw: Array,
    q_kvar: Array,
    source_voltage_pu: Array | float | None = None,
    control: Control | None = None,
    tap: Array | None = None,
    *,
    controlled: Array | None = None,
    move: Move = one_tap,
    settings: RelaySettings | None = None,
    target_v: Array | None = None,
) -> SettledTaps:
    """Settle the taps of a batch of rows, each row by itself.

    Parameters
    ----------
    feeder, p_kw, q_kvar, source_voltage_pu, control
        What ``powerflow.solve_unbalanced`` takes, loads of shape (row, n_leg); ``control.tap_ratio`` is set aside.
    tap
        Where they begin, (row, n_regulator); at the base taps where it is None.
    controlled
        1 for a regulator that moves and 0 for one that stays where it begins, (n_regulator,); None where all move.
    move
        How many taps are made in a round.
    settings
        Settings of the relays, arrays like the loads; those of the feeder's table where it is None.
    target_v
        Targets of each row, V, (row, n_regulator); those of the settings where it is None.
    """
    p_kw, q_kvar = (a.detach() if hasattr(a, "detach") else a for a in (p_kw, q_kvar))
    xp = namespace(p_kw)
    relays = settings or settings_like(relay_settings(feeder), p_kw)
    n_row = p_kw.shape[0]
    zero = 0.0 * p_kw[:, :1] + as_like(np.zeros(feeder.n_regulator), p_kw)
    taps = zero + as_like(feeder.base_tap, p_kw) if tap is None else tap
    rows = xp.arange(n_row, device=p_kw.device)
    settled = rows < 0
    before, start, rounds = [taps], None, 0
    while len(rows) and feeder.n_regulator and rounds < MOST_ROUNDS:
        rounds += 1
        solution = _solve(feeder, p_kw, q_kvar, source_voltage_pu, control, taps, rows, start)
        volts = relay_volts(relays, solution)
        now = relays if target_v is None else relays._replace(target_v=target_v[rows])
        turn = _turns(now, volts, taps[rows], controlled) * move(now, now.target_v - volts)
        turn = xp.where(solution.converged[:, None], turn, 0.0 * turn)
        after = xp.minimum(xp.maximum(taps[rows] + turn, relays.lowest + 0.0 * turn), relays.highest + 0.0 * turn)
        rests = (turn == 0.0).all(-1)
        settled = put_rows(settled, rows, rests & solution.converged)
        taps = put_rows(taps, rows, after)
        came_back = rests
        for earlier in before:
            came_back = came_back | (earlier[rows] == after).all(-1)
        before.append(taps)
        goes_on = ~came_back
        rows, start = rows[goes_on], solution.restart[goes_on]
    return SettledTaps(taps, settled if feeder.n_regulator else ~settled, rounds)


def _solve(
    feeder: ThreePhaseFeeder,
    p_kw: Array,
    q_kvar: Array,
    source: Any,
    control: Control | None,
    tap: Array,
    rows: Array,
    start: Array | None,
) -> ThreePhaseSolution:
    """The power flow of some rows at their taps."""
    n_row = p_kw.shape[0]
    shunt, capacitor = (None, None) if control is None else (control.shunt_kvar, control.capacitor_on)
    of_rows = [None if a is None else a[rows] if a.ndim > 1 else a for a in (shunt, capacitor)]
    source = source[rows] if getattr(source, "shape", ()) == (n_row,) else source
    changed = Control(feeder.tap_ratio(tap[rows]), *of_rows)
    return solve_unbalanced(feeder, p_kw[rows], q_kvar[rows], source, changed, start)


def _turns(settings: RelaySettings, volts: Array, tap: Array, controlled: Array | None) -> Array:
    """Which way each regulator goes in a round: of those that would, those with the shortest delay."""
    xp = namespace(tap)
    wanted = direction(settings, volts, tap)
    wanted = wanted if controlled is None else wanted * controlled
    delay = xp.where(wanted != 0.0, settings.delay_s + 0.0 * tap, 0.0 * tap + np.inf)
    return xp.where(delay <= min_last(delay), wanted, 0.0 * tap)
