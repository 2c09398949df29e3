"""Search for the best tap trajectory that built-in controls can be led to, by dynamic programming.

Reactive power decides where relay volts lie, and so which taps are made and when. The search takes one regulator after
the other and keeps the trajectories of all others. Programs over the reactive power of one step give the least cost of
that step, for each tap position near the present one and each side of the band. Dynamic programming (R. Bellman,
"Dynamic programming", 1957) then finds the least cost of the episode, over the tap, the timer and whether the relay is
in a sequence. The relay rule is that of ``timed_taps`` with delays of whole steps:

- Before the delay is over, a step out of band adds 1 to the timer. A step in band takes 1 off it, or resets it.
- When the delay is over, a relay out of band makes a tap, which begins a sequence. Otherwise it is held in band.
- In a sequence the timer runs on either side. At its end the relay makes a further tap or, in band, ends the sequence.

The grid is linear around the trajectory of an ``EpisodeProgram``, and the work served is that of the trajectory.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env import beyond_band, voltage_targets
from dcgrid_env.baselines.model_based.episode_program import EpisodeProgram
from dcgrid_env.baselines.model_based.lookahead import Program, solve
from dcgrid_env.baselines.model_based.tap_trajectory import ABOVE, ANY, BELOW, IN_BAND, MARGIN_V, Demands, TapTrajectory

REACH = 1
"""Each regulator is tried at the taps of its present trajectory and so many beyond."""
ROUNDS = 120
"""Rounds of the solver of the programs of a step."""
SWEEPS = 3
"""Most passes over all regulators around one trajectory."""
SETTLED = 1e-4
"""Change of the cost in a pass, as a share of it, at which passes end."""
_PER_VOLT = 0.1  # a volt in the units of a program, in which voltages are per unit
_DEMAND_PRICE = 20.0  # cost of a volt off a demand in a program
_NO_LIMIT = -1.0  # offset of a limit that does not apply


class _Costs(NamedTuple):
    """Least cost of each step for a relay, (T, K) for K positions of its tap; infinite where it cannot be."""

    anywhere: np.ndarray
    in_band: np.ndarray
    out_of_band: np.ndarray
    side: np.ndarray
    """Side of the band on which ``out_of_band`` is."""
    up: np.ndarray
    """With a tap from this position at the beginning of the step."""
    down: np.ndarray


class TapSearch:
    """The search around an episode program's trajectory, which moves with the program's solutions."""

    def __init__(self, program: EpisodeProgram) -> None:
        assert program.relays is not None
        self.program, self.relays = program, program.relays
        s, w = program.scenario, program.scenario.cost.weights
        self._integrating = s.grid_control.regulator_settings.timer == "integrating"
        self.price = program.tap_price * s.horizon
        """Cost of a tap, in units of the cost of a step."""
        n_bus = len(s.feeder.load_nodes)
        self._weights = w.voltage / n_bus, w.violation / n_bus, np.full(program.n, w.effort / s.n_agents)
        self._target = voltage_targets(s)[s.feeder.load_slice] - 1.0

    def around(self) -> None:
        """Linearise the grid around the program's trajectory."""
        p, s = self.program, self.program.scenario
        solution = p.flows()
        served = np.concatenate((p.served_kw, p.storage_kw), axis=1)
        (self._v, self._v_by_q), (self._u, self._u_by_q) = (
            (linear.at_zero + np.einsum("tnd,td->tn", linear.by_d, served), linear.by_q)
            for linear in (p.linear(solution.v_pu[..., s.feeder.load_slice]), p.linear(self.relays.volts(solution)))
        )
        rows, highest = self.relays.rows, self.relays.settings.highest
        way = np.where(p.taps[1:] < highest, 1.0, -1.0)[None] * np.eye(len(highest))[rows][:, None]
        moved = p.flows_at(p.taps[1:] + np.concatenate((0.0 * way[:1], way)))
        self._v_by_tap, self._by_tap = (
            (values[1:] - values[0]) * way.sum(axis=-1)[..., None]
            for values in (
                measured.reshape(1 + len(rows), s.horizon, -1)
                for measured in (moved.v_pu[..., s.feeder.load_slice], self.relays.volts(moved))
            )
        )
        n_dc = s.datacenters.count
        drawn_kw, rated_kva = p.base_kw + p.served_kw, p.s_rated_kva[:n_dc]
        room = np.sqrt(np.maximum(np.maximum(rated_kva, drawn_kw) ** 2 - drawn_kw**2, 0.0))
        self._q_high = p.q_limit_kvar.copy()
        self._q_high[:, :n_dc] = np.minimum(self._q_high[:, :n_dc], room)
        self._tap = p.taps[1:, rows]

    def improved(self, trajectory: TapTrajectory) -> tuple[TapTrajectory, float]:
        """Return the best trajectory that was found from another, and its mean cost of a step.

        Delays of work are not in the cost. Call ``around`` first.
        """
        cost = before = np.inf
        for _ in range(SWEEPS):
            for relay in range(len(self.relays.rows)):
                trajectory, cost = self._best_trajectory(trajectory, relay)
            if before - cost <= SETTLED * abs(cost):
                break
            before = cost
        return trajectory, cost

    def _best_trajectory(self, trajectory: TapTrajectory, relay: int) -> tuple[TapTrajectory, float]:
        """The best trajectory of one regulator among all others' trajectories, and the cost."""
        settings, row = self.relays.settings, self.relays.rows[relay]
        tap = trajectory.tap[:, relay]
        first = max(tap.min() - REACH, settings.lowest[row])
        positions = np.arange(first, min(tap.max() + REACH, settings.highest[row]) + 1.0)
        costs = self._costs(trajectory, relay, positions)
        delays = int(self.relays.steps[relay]), int(self.relays.further_steps[relay])
        plan = _Plan(costs, delays, self._integrating, self.price)
        own_tap, side, due = plan.follow(int(tap[0] - first))
        parts = (trajectory.tap.copy(), trajectory.side.copy(), trajectory.due.copy())
        for part, best in zip(parts, (own_tap + first, side, due), strict=True):
            part[:, relay] = best
        return TapTrajectory(*parts), plan.cost(int(tap[0] - first)) / len(side)

    def _costs(self, trajectory: TapTrajectory, relay: int, positions: np.ndarray) -> _Costs:
        """Costs of each step at these positions of a regulator's tap."""
        settings, row = self.relays.settings, self.relays.rows[relay]
        steps, k = len(trajectory.side), len(positions)
        away = trajectory.tap[1:] - self._tap
        away[:, relay] = 0.0
        v_pu = self._v + np.einsum("tr,rtn->tn", away, self._v_by_tap)
        volts = self._u + np.einsum("tr,rtn->tn", away, self._by_tap)
        moved = (positions - self._tap[:, relay, None])[..., None]
        v_pu = v_pu[:, None] + moved * self._v_by_tap[relay][:, None]
        volts = volts[:, None] + moved * self._by_tap[relay][:, None]
        others = trajectory.demands(self.relays, np.einsum("tr,rtn->tn", trajectory.moves, self._by_tap))
        relay_slope = self._by_tap[relay][:, relay, None]
        all_steps = np.repeat(np.arange(steps), k)

        def solved(step: np.ndarray, position: np.ndarray, low: Any, high: Any) -> tuple[np.ndarray, np.ndarray]:
            sides = others.low[step] + MARGIN_V, others.high[step] - MARGIN_V
            sides[0][:, relay], sides[1][:, relay] = low, high
            return self._solved(step, v_pu[step, position], volts[step, position], Demands(*sides))

        everywhere = np.full(steps * k, np.inf)
        anywhere, relay_v = solved(all_steps, np.tile(np.arange(k), steps), -everywhere, everywhere)
        anywhere, relay_v = anywhere.reshape(steps, k), relay_v[:, relay].reshape(steps, k)
        low_v, high_v = (edge[relay] for edge in self.relays.band_volts)
        can_rise, can_fall = positions < settings.highest[row], positions > settings.lowest[row]

        def between(low: np.ndarray, high: np.ndarray, possible: np.ndarray, way: int = 0) -> np.ndarray:
            """Cost with relay volts between these, (K,), at the position before a tap this way."""
            after = np.clip(np.arange(k) + way, 0, k - 1)
            possible = possible & (after == np.arange(k) + way)
            low, high = low + MARGIN_V + way * relay_slope, high - MARGIN_V + way * relay_slope
            met = (relay_v[:, after] >= low) & (relay_v[:, after] <= high)
            cost = np.where(possible, anywhere[:, after], np.inf)
            step, position = np.nonzero(possible & ~met)
            if step.size:
                cost[step, position] = solved(step, after[position], low[step, position], high[step, position])[0]
            return cost

        any_v, low_v, high_v = (np.full(k, edge) for edge in (np.inf, low_v, high_v))
        below, above = between(-any_v, low_v, can_rise), between(high_v, any_v, can_fall)
        return _Costs(
            anywhere,
            between(np.where(can_rise, low_v, -np.inf), np.where(can_fall, high_v, np.inf), np.ones(k, bool)),
            np.minimum(below, above),
            np.where(below <= above, BELOW, ABOVE),
            between(-any_v, low_v, can_rise, 1),
            between(high_v, any_v, can_fall, -1),
        )

    def _solved(
        self, step: np.ndarray, v_pu: np.ndarray, volts: np.ndarray, demands: Demands
    ) -> tuple[np.ndarray, np.ndarray]:
        """Least cost of programs of one step each, (n,), and the relay volts there, (n, R).

        From the voltages (n, n_load_node) and the relay volts without reactive power. Programs of the same step are
        solved together as one row of ``lookahead``, in the place of its steps.
        """
        order = np.argsort(step, kind="stable")
        rows, first, count = np.unique(step[order], return_index=True, return_counts=True)
        row, place = np.repeat(np.arange(len(rows)), count), np.arange(len(step)) - np.repeat(first, count)
        where = np.empty((2, len(step)), np.int64)
        where[:, order] = row, place
        beyond = np.concatenate((volts - demands.high, demands.low - volts), axis=1)
        limits = np.where(np.isfinite(beyond), _PER_VOLT * beyond, _NO_LIMIT)
        offset = np.zeros((len(rows), count.max(), v_pu.shape[1] + limits.shape[1]))
        offset[tuple(where)] = np.concatenate((v_pu - 1.0, limits), axis=1)
        size = self.program.s_rated_kva
        of_v, of_u = (np.moveaxis(slopes[rows], 1, 2) * size[:, None] for slopes in (self._v_by_q, self._u_by_q))
        empty = np.zeros((*offset.shape[:2], 0))
        voltage, violation, effort = self._weights
        program = Program(
            offset=offset,
            slopes=np.concatenate((of_v, _PER_VOLT * of_u, -_PER_VOLT * of_u), axis=-1),
            base=empty,
            low=empty,
            high=empty,
            s_rated=empty,
            q_high=self._q_high[rows] / size,
            work=empty,
            price=empty[0],
            voltage=voltage,
            violation=violation,
            effort=effort,
            band_pu=self.program.scenario.cost.band_pu,
            target=self._target,
            uncharged_pu=self.program.scenario.cost.uncharged_pu,
            n_limits=limits.shape[1],
            beyond_limit=_DEMAND_PRICE / _PER_VOLT,
        )
        y = solve(program, None, ROUNDS).y
        off, beyond = np.split(offset + np.matmul(y, program.slopes), [v_pu.shape[1]], axis=-1)
        cost = voltage * beyond_band(off - self._target, program.uncharged_pu).sum(axis=-1)
        cost += violation * beyond_band(off, program.band_pu).sum(axis=-1)
        cost += np.abs(y) @ effort + program.beyond_limit * np.maximum(beyond, 0.0).sum(axis=-1)
        return cost[tuple(where)], volts + np.matmul(y, of_u)[tuple(where)]


_HOLD, _OUT, _UP, _DOWN, _WAIT = range(5)
"""A step of a relay: it is in band, is out of it, makes a tap, or its timer runs on in a sequence."""


class _Plan:
    """The best policy of one relay over its tap, its timer and whether it is in a sequence."""

    def __init__(self, costs: _Costs, delays: tuple[int, int], integrating: bool, price: float) -> None:
        self.costs, (self.delay, self.further) = costs, delays
        self.back = 1 if integrating else self.delay
        """Steps that a timer loses in a step in band."""
        steps, k = costs.anywhere.shape
        timer = np.arange(self.delay)
        down = np.maximum(timer - self.back, 0)
        # Cost to come, by the position of the tap and the timer, outside a sequence and within one.
        outside, within = np.zeros((k, self.delay + 1)), np.zeros((k, self.further + 1))
        self.outside, self.within = (
            np.full((steps, *costs_to_come.shape), _WAIT, np.int8) for costs_to_come in (outside, within)
        )
        for t in range(steps - 1, -1, -1):
            hold, out = costs.in_band[t], costs.out_of_band[t]
            after_tap = within[:, min(1, self.further)]
            up = costs.up[t] + price + np.append(after_tap[1:], np.inf)
            fall = costs.down[t] + price + np.append(np.inf, after_tap[:-1])
            kept, left = hold[:, None] + outside[:, down], out[:, None] + outside[:, timer + 1]
            self.outside[t, :, :-1] = np.where(left < kept, _OUT, _HOLD)
            ends = []
            for chosen, stay in ((self.outside, max(self.delay - self.back, 0)), (self.within, 0)):
                ways = np.stack((hold + outside[:, stay], up, fall))
                chosen[t, :, -1] = np.array((_HOLD, _UP, _DOWN))[ways.argmin(axis=0)]
                ends.append(ways.min(axis=0))
            waits = costs.anywhere[t][:, None] + within[:, 1:]
            outside = np.concatenate((np.minimum(kept, left), ends[0][:, None]), axis=1)
            within = np.concatenate((waits, ends[1][:, None]), axis=1)
        self._least = outside[:, 0]

    def cost(self, position: int) -> float:
        """Least cost of the episode from a position of the tap."""
        return float(self._least[position])

    def follow(self, position: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions at t = 0 and after each step (1 + T,), sides of the band and whether the delay is over, (T,)."""
        positions, sides, due, timer, within = [position], [], [], 0, False
        for t in range(len(self.outside)):
            does = (self.within if within else self.outside)[t, position, timer]
            due.append(timer == (self.further if within else self.delay))
            if does in (_UP, _DOWN):
                sides.append(BELOW if does == _UP else ABOVE)
                position += 1 if does == _UP else -1
                timer, within = min(1, self.further), True
            elif does == _HOLD:
                sides.append(IN_BAND)
                timer, within = 0 if within else max(timer - self.back, 0), False
            else:
                sides.append(self.costs.side[t, position] if does == _OUT else ANY)
                timer += 1
            positions.append(position)
        return np.array(positions, float), np.array(sides), np.array(due)
