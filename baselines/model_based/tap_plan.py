"""Plan the taps that regulators' built-in controls make, and the relay volts that lead to them.

A control moves its tap if its relay is out of band when its delay ends (``timed_taps``). In each step a relay is free,
held in band, or pushed out of band on the side of a useful tap. A relay whose tap is to stay is held when its delay
ends, and also earlier if its timer integrates. One whose tap is to move is pushed until its delay ends.

Held and pushed relays have a demand on their volts in the coming step, with a margin for the error of the prediction.

Targets of the taps come from a local search for the least long-run cost. In each step it tries one tap of each
regulator, and, for one regulator in turn, a tap of it together with one of another:

    c(taps) = (1 - s) c_free(taps) + s c_held(taps) + a price for each tap away from the present ones

A relay that is otherwise out of band is held in the share s of all steps. It is one step per delay for a timer that
resets, and half of all steps for one that integrates. The price is that of switching in the cost, over the steps left
or ``LASTS_S``. If the cost has none, it is a share of the voltage's cost, because gains change with the load.

Where timers integrate, a hold has a value before the delay ends, since the timer falls. It is ``HOLD_VALUE`` times the
mean cost so far of holding all relays, times the share of the delay that is over. So relays are held in steps in which
that is cheap, and a hold that fails moves no tap. A step of a push is worth the gain of the taps until the end of the
episode, divided by the steps that they take.

The candidates for the coming step are the last choice, that choice with one relay changed, and all relays in the same
mode. The plan takes the candidate with the least cost of the step plus the expected later cost of its taps. All costs
are optima of one-step programs over reactive power. ``lookahead`` solves them together, with candidates in the place of
steps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env import RegulatorState, beyond_band
from dcgrid_env.baselines.model_based.lookahead import Iterate, Program, restarted, solve
from dcgrid_env.baselines.model_based.relay_model import RelayModel

MARGIN = 2.0
"""Margin of a demand, as a multiple of the root mean square error of the prediction so far."""
TAP_PRICE = 0.04
"""Share of the cost of the voltage that a tap moves, which it has to save in each step if the cost has no price."""
LASTS_S = 300.0
"""Longest time in which a tap has to save its price, s: gains change with the load."""
HOLD_VALUE = 1.5
"""Value of holding a relay in band at the end of its delay, in mean costs of a hold."""
_DEMAND_PRICE = 20.0  # cost of a volt off a demand in a program
_LONG_RUN_PRICE = 1.0  # the same in the long run, where a tap follows, which is not as bad
_PER_VOLT = 0.1  # a volt in the units of the program, in which voltages are per unit
_ROUNDS = 60  # of the solver in each step
_NO_LIMIT = -1.0  # offset of a limit that does not apply
_FIRST_ERROR_V, _FIRST_COUNT = 0.1, 5.0  # error assumed before there are measurements, and its weight
_SAME_TIME_S = 1e-6
_FREE, _PUSHED, _KEPT = 0.0, 1.0, -1.0


class Outlook(NamedTuple):
    """A step without reactive power."""

    deviation_pu: np.ndarray
    """Voltages less 1 p.u., (row, n_load_node)."""
    relay_v: np.ndarray
    """Relay volts, (row, R)."""


class Demands(NamedTuple):
    """Lowest and highest relay volts that a step is to have, infinite where any are allowed, (row, .., R)."""

    low: np.ndarray
    high: np.ndarray


class Choice(NamedTuple):
    """Demands on the coming step."""

    demands: Demands
    taps: np.ndarray
    """Taps that are made at its beginning if these are met, (row, R)."""


class _LongRun(NamedTuple):
    """What taps save or cost in each step, (row, R)."""

    gain: np.ndarray
    """Saved by each regulator's taps up to its target."""
    up: np.ndarray
    """Cost of a tap up."""
    down: np.ndarray


class TapPlan:
    """The plan for the regulators of a batch of environments over an episode.

    Parameters
    ----------
    model
        The relays' model.
    dt_s
        Length of a step, s.
    integrating
        Whether timers count down in band.
    price
        Cost of a tap, in units of the cost of a step.
    """

    def __init__(self, model: RelayModel, dt_s: float, integrating: bool, price: float) -> None:
        self.model, self._dt_s, self._price = model, dt_s, price
        relays, rows = model.relays, model.relays.rows
        self._delay_s, self._tap_delay_s = relays.settings.delay_s[rows], relays.settings.tap_delay_s[rows]
        self._lowest, self._highest = relays.settings.lowest[rows], relays.settings.highest[rows]
        self._integrating = integrating
        self._held_share = 0.5 if integrating else dt_s / max(self._delay_s.min(), 2.0 * dt_s)
        self._target: np.ndarray | None = None
        self._mode: np.ndarray | None = None
        self._expected_v: np.ndarray | None = None
        self._hold_cost: np.ndarray | float = 0.0
        self._holds: np.ndarray | float = 0.0
        self._runs: Iterate | None = None
        self._steps: Iterate | None = None

    def limited(self, program: Program, slopes: np.ndarray) -> Program:
        """The program with limits for the relays, whose volts have these slopes by its unknowns, (row, n, R)."""
        both = _PER_VOLT * np.concatenate((slopes, -slopes), axis=-1)
        both = np.broadcast_to(both, (len(program.slopes), *both.shape[1:]))
        return program._replace(
            slopes=np.concatenate((program.slopes, both), axis=-1),
            n_limits=both.shape[-1],
            beyond_limit=_DEMAND_PRICE / _PER_VOLT,
        )

    def offset(self, deviation_pu: np.ndarray, relay_v: np.ndarray, demands: Demands) -> np.ndarray:
        """Offsets of a limited program from those of the voltages and the relay volts, (row, step, m + 2 R)."""
        beyond = np.concatenate((relay_v - demands.high, demands.low - relay_v), axis=-1)
        limits = np.where(np.isfinite(beyond), _PER_VOLT * beyond, _NO_LIMIT)
        lead = np.broadcast_shapes(deviation_pu.shape[:-1], limits.shape[:-1])
        both = (np.broadcast_to(part, (*lead, part.shape[-1])) for part in (deviation_pu, limits))
        return np.concatenate(tuple(both), axis=-1)

    def choose(
        self, program: Program, usual: Outlook, next_step: Outlook, regulators: RegulatorState, steps_left: int
    ) -> Choice:
        """Choose the demands on the coming step.

        Parameters
        ----------
        program
            Limited program whose unknowns are the reactive powers; its offsets do not matter.
        usual, next_step
            A step with the usual draws of the sites, and the coming one.
        regulators
            All regulators of the feeder, as measured.
        steps_left
            Steps until the end of the episode.
        """
        rows = self.model.relays.rows
        tap, in_sequence = regulators.tap[:, rows], regulators.in_sequence[:, rows] > 0.0
        self._measure_error(tap, regulators.relay_v[:, rows])
        self._target = tap if self._target is None else self._target
        long_run = self._search(program, usual, tap, steps_left)
        wanted, far = np.sign(self._target - tap), np.abs(self._target - tap)
        left_s = np.where(in_sequence, self._tap_delay_s, self._delay_s) - regulators.out_of_band_s[:, rows]
        due = left_s < self._dt_s - _SAME_TIME_S
        wait = np.where(in_sequence, 0.0, np.maximum(np.ceil(left_s / self._dt_s - _SAME_TIME_S), 0.0))
        worth = long_run.gain * np.maximum(steps_left - wait - far + 1.0, 0.0) / np.maximum(wait + far, 1.0)
        # After a tap the delay runs in any case.
        early = self._integrating & (wanted == 0.0) & ~in_sequence & ~due
        modes = self._candidates(due, early, (wanted != 0.0) & (due | ~in_sequence))
        demands = self._demands(modes, wanted[:, None], tap[:, None])
        offset = self.offset(next_step.deviation_pu[:, None], next_step.relay_v[:, None], demands)
        cost, self._steps = self._solved(program, offset, self._steps)
        slopes = program.slopes[..., -program.n_limits : -len(rows)] / _PER_VOLT
        up, down = self._likelihoods(next_step.relay_v[:, None] + np.matmul(self._steps.y, slopes), tap[:, None])
        if_due = steps_left * (up * long_run.up[:, None] + down * long_run.down[:, None])
        if_not = -worth[:, None] * np.where(wanted[:, None] > 0.0, up, down) * (modes == _PUSHED)
        elapsed = 1.0 - left_s / np.maximum(np.minimum(self._delay_s, steps_left * self._dt_s), self._dt_s)
        value = HOLD_VALUE * self._mean_hold_cost(cost, due | early) * np.maximum(elapsed, 0.0)
        if_not -= (value * early)[:, None] * (1.0 - up - down)
        best = (cost + np.where(due[:, None], if_due, if_not).sum(axis=-1)).argmin(axis=1)
        row = np.arange(len(tap))
        self._mode, self._coming_v = modes[row, best], next_step.relay_v
        chosen = Demands(demands.low[row, best], demands.high[row, best])
        return Choice(chosen, np.where(due & (self._mode == _PUSHED), wanted, 0.0))

    def expect(self, q_kvar: np.ndarray) -> None:
        """Keep the relay volts that are expected with the reactive powers that were decided, (row, n_agent)."""
        self._expected_v = self._coming_v + np.matmul(q_kvar[:, None], self.model.by_q)[:, 0]

    def _measure_error(self, tap: np.ndarray, relay_v: np.ndarray) -> None:
        """Take the error of the prediction from the steps without a tap so far."""
        if self._expected_v is None:
            self._squares, self._count = np.full_like(tap, _FIRST_COUNT * _FIRST_ERROR_V**2), _FIRST_COUNT
        else:
            stayed = (tap == self._tap).all(axis=1, keepdims=True)
            self._squares = self._squares + np.where(stayed, (relay_v - self._expected_v) ** 2, 0.0)
            self._count = self._count + stayed
        self._tap, self._error_v = tap, np.sqrt(self._squares / self._count)

    def _demands(self, modes: np.ndarray, wanted: np.ndarray | float, tap: np.ndarray) -> Demands:
        """Demands on relays in these modes, at these taps, (row, k, R)."""
        margin = MARGIN * self._error_v[:, None]
        low, high = self.model.relays.band_volts
        rest_low, rest_high = self.model.relays.rest_volts(tap)
        kept, pushed = modes == _KEPT, modes == _PUSHED
        return Demands(
            np.where(kept, rest_low + margin, np.where(pushed & (wanted < 0.0), high + margin, -np.inf)),
            np.where(kept, rest_high - margin, np.where(pushed & (wanted > 0.0), low - margin, np.inf)),
        )

    def _candidates(self, due: np.ndarray, early: np.ndarray, useful: np.ndarray) -> np.ndarray:
        """Modes of the relays in each candidate, (row, k, R); in the last three all relays are alike.

        A relay is held only if it is ``due`` or may be held ``early``, and pushed only where it is ``useful``.
        """
        n = due.shape[-1]
        last = np.full(due.shape, _FREE) if self._mode is None else self._mode
        changed = [np.where(np.eye(n, dtype=bool), mode, last[:, None]) for mode in (_FREE, _PUSHED, _KEPT)]
        alike = np.broadcast_to(np.array([_FREE, _PUSHED, _KEPT])[:, None], (len(due), 3, n))
        modes = np.concatenate((last[:, None], *changed, alike), axis=1)
        modes = np.where((modes == _PUSHED) & ~useful[:, None], np.where(due, _KEPT, _FREE)[:, None], modes)
        return np.where((modes == _KEPT) & ~(due | early)[:, None], _FREE, modes)

    def _mean_hold_cost(self, cost: np.ndarray, can_hold: np.ndarray) -> np.ndarray:
        """Mean cost so far of holding all relays that can be held, (row, 1); ``cost`` is that of the candidates."""
        some = can_hold.any(axis=1, keepdims=True)
        self._hold_cost = self._hold_cost + np.where(some, np.maximum(cost[:, -1:] - cost[:, -3:-2], 0.0), 0.0)
        self._holds = self._holds + some
        return self._hold_cost / np.maximum(self._holds, 1.0)

    def _search(self, program: Program, usual: Outlook, tap: np.ndarray, steps_left: int) -> _LongRun:
        """Move the targets to the best of their neighbours."""
        assert self._target is not None
        target, one, now = self._target[:, None], np.eye(tap.shape[-1]), tap[:, None]
        turn = steps_left % len(one)
        pairs = np.delete(one, turn, axis=0) + one[turn]
        taps = np.concatenate((now, target, target + one, target - one, target + pairs, target - pairs), axis=1)
        change = taps - now
        deviation_pu = usual.deviation_pu[:, None] + change @ self.model.v_by_tap
        relay_v = usual.relay_v[:, None] + change @ self.model.by_tap
        demands = (self._demands(np.full_like(taps, mode), 0.0, taps) for mode in (_FREE, _KEPT))
        offset = np.concatenate([self.offset(deviation_pu, relay_v, demand) for demand in demands], axis=1)
        cost, self._runs = self._solved(program, offset, self._runs, _LONG_RUN_PRICE)
        free, kept = np.split(cost, 2, axis=1)
        cost = free + self._held_share * (kept - free)
        price = np.full(len(one), self._price / min(steps_left, max(LASTS_S / self._dt_s, 1.0)))
        if not self._price:
            price = TAP_PRICE * program.voltage * np.abs(self.model.v_by_tap).sum(axis=-1)
        cost += np.abs(change) @ price
        inside = ((taps >= self._lowest) & (taps <= self._highest)).all(axis=-1)
        best, row = np.where(inside, cost, np.inf).argmin(axis=1), np.arange(len(tap))
        self._target = taps[row, best]
        moves = self._target - tap
        each = (cost[:, 0] - cost[row, best])[:, None] / np.maximum(np.abs(moves).sum(axis=1, keepdims=True), 1.0)
        up, down = np.split(cost[:, 2 : 2 + 2 * len(one)] - cost[:, 1:2], 2, axis=1)
        return _LongRun(each * np.abs(moves), np.where(moves > 0.0, -each, up), np.where(moves < 0.0, -each, down))

    def _likelihoods(self, relay_v: np.ndarray, tap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Likelihood that relays with these expected volts ask for a tap up, and for one down."""
        low, high = self.model.relays.rest_volts(tap)
        sides = (beyond / self._error_v[:, None] for beyond in (low - relay_v, relay_v - high))
        up, down = (0.5 + 0.5 * np.tanh(0.85 * side) for side in sides)  # the normal distribution to within 0.01
        return up, down

    def _solved(
        self, program: Program, offset: np.ndarray, start: Iterate | None, demand_price: float = 0.0
    ) -> tuple[np.ndarray, Iterate]:
        """Cost of each candidate (row, k) with its offsets, and the solver's iterate."""
        empty = np.zeros((*offset.shape[:2], 0))
        candidates = program._replace(
            offset=offset, base=empty, low=empty, high=empty, s_rated=empty, work=empty, price=empty[0]
        )
        solution = solve(candidates, None if start is None else restarted(candidates, start), _ROUNDS)
        v_pu, beyond = np.split(offset + np.matmul(solution.y, program.slopes), [-program.n_limits], axis=-1)
        off = v_pu if program.target is None else v_pu - program.target
        cost = program.voltage * beyond_band(off, program.uncharged_pu).sum(axis=-1)
        cost += program.violation * beyond_band(v_pu, program.band_pu).sum(axis=-1)
        cost += np.abs(solution.y) @ program.effort
        return cost + demand_price / _PER_VOLT * np.maximum(beyond, 0.0).sum(axis=-1), solution
