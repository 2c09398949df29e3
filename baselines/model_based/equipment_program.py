"""The program of an episode in which regulators and capacitor banks are agents: their positions are unknowns too.

The program extends ``episode_program``:

    over   u          taps, and switches between 0 and 1, of the equipment that is agents
    cost   switching times the mean of |u_t - u_{t-1}|, as the reward has it
    with   u within its range, and |u_t - u_{t-1}| at most what a drive makes in a step

Positions are whole numbers. As continuous unknowns they make the program a relaxation, whose optimum is below every
controller's cost, apart from the grid's curvature. ``round`` makes whole numbers of them, and the program is then
solved for work and reactive power alone.

Agents of set points do not choose positions. The program plans the positions that the controls take under their set
points, and ``set_point_plan`` finds set points that lead to them.

All costs and constraints are hinges of unknowns of one step or two, and ``interior_point`` solves such programs.
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np
from scipy import sparse

from dcgrid_env import Control, Forecast, Recorder, Scenario, acting_relays, action_layout, voltage_targets
from dcgrid_env.baselines.equipment_agents import action_of, at_rest
from dcgrid_env.baselines.model_based.episode_program import TANGENTS
from dcgrid_env.baselines.model_based.interior_point import TOLERANCE, Rows, minimise
from dcgrid_env.baselines.model_based.set_point_plan import bank_set_points, relay_set_points
from dcgrid_env.baselines.model_based.trajectory import HindsightError, Trajectory

_SPAN = 0.1  # of a tap or a bank, by which the power flow is tried to find its slopes
_NARROWEST = 1e-3  # kvar, kW s: no range is so narrow that it has no inside
_SHORTEST_S = 1e-6  # of a delay between taps, which may be 0
CHANNELS = {"tap_changer": "tap", "capacitor_bank": "on"}
"""Channel of each kind of device that is equipment."""
SETTERS = ("regulator_setpoint", "capacitor_setpoint")
"""Kinds of agents that choose the set points of equipment."""


class Group(NamedTuple):
    """The equipment of a group of agents, n pieces: regulators or capacitor banks."""

    device: Any
    are_taps: bool
    rows: list[int]
    """Rows in the feeder's table of regulators or capacitors."""
    lowest: np.ndarray
    """Lowest position, (n,)."""
    highest: np.ndarray
    rest: np.ndarray
    """Position in the feeder's tables."""
    most: np.ndarray
    """Largest move in a step."""


class EquipmentProgram(Trajectory):
    """The program of an episode with equipment that is agents, around the trajectory of its last solution.

    Unknowns of a step, one after the other: b (n_dc), q (n), and, while positions are not rounded, u.
    """

    def __init__(self, scenario: Scenario, episode: Forecast, keep_band: bool) -> None:
        super().__init__(scenario, episode)
        self.keep_band = keep_band
        self.target_pu, free_pu = voltage_targets(scenario)[scenario.feeder.load_slice], scenario.cost.uncharged_pu
        self.edges_pu = (free_pu, -free_pu) if free_pu else (0.0,)
        """Distances from the targets at which the cost of a deviation has a kink."""
        self.groups = [_group(scenario, device) for device in scenario.devices if device.kind in (*CHANNELS, *SETTERS)]
        self.lowest, self.highest, self.rest, self.most = (
            np.concatenate(parts) for parts in zip(*(group[3:] for group in self.groups), strict=True)
        )
        """Range of each position, its value at t = 0 and its largest move in a step, (n_u,)."""
        self.position = np.tile(self.rest, (scenario.horizon, 1))
        """Taps, then switches, of the equipment that is agents, (T, n_u)."""
        self.is_whole = False

    @property
    def n_further(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """A power flow for each position that is unknown."""
        return 0 if self.is_whole else len(self.rest)

    def round(self) -> None:
        """Make whole numbers of the positions, and unknowns no more."""
        self.position, self.is_whole = np.rint(self.position), True

    def follow(self, replayed: Recorder) -> None:
        """Take positions as they were in a replay: of all equipment if rounded, else of all that are not agents."""
        super().follow(replayed)
        self.rest = self._of_groups(self._first_tap, self._first_on)
        if self.is_whole:
            self.position = self._of_groups(self._tap, self._on)

    def solve(self, tolerance: float = TOLERANCE) -> tuple[float, np.ndarray]:
        """Optimum, to a share of it, and the actions (T, n_action) behind it; the next program is around them."""
        s = self.scenario
        n_dc, n_u, steps = s.datacenters.count, self.n_further, s.horizon
        v_pu, dense = self._around_positions(self.flows().v_pu[..., s.feeder.load_slice])
        k = dense.shape[-1]
        one, shift = sparse.identity(steps), sparse.eye(steps, k=-1)
        of_d = np.arange(k) < n_dc
        served = sparse.kron(one, sparse.diags(np.where(of_d, -1.0 / s.dt_s, 1.0)))
        served += sparse.kron(shift, sparse.diags(np.where(of_d, 1.0 / s.dt_s, 0.0)))  # d_t - a_t from b_t, b_{t-1}
        quantities = sparse.csr_array(served)
        v_pu = v_pu + (dense[..., :n_dc] @ self.arrived_kw[..., None])[..., 0]
        c, constant = self._linear_costs(v_pu, dense, quantities)
        h, bounds = self._of_voltages(v_pu)
        other, h_other, k_other = self._of_steps(quantities, k)
        times = (*(1.0 for _ in self.edges_pu), 1.0, -1.0)
        rows = Rows(dense, quantities, times, other, 2 * k - 1)
        h, limits = np.concatenate((h, h_other)), np.concatenate((bounds, k_other))
        start = np.concatenate((np.zeros((steps, n_dc)), self.q_kvar, self.position[:, :n_u]), axis=1).ravel()
        try:
            optimum = minimise(c, rows, h, limits, start, constant, tolerance)
        except ArithmeticError as error:
            band = "; keep_band may ask for what cannot be" if self.keep_band else ""
            raise HindsightError(f"hindsight of scenario {s.name!r} has no solution: {error}{band}") from None
        x = optimum.x.reshape(steps, k)
        self.served_kw = (quantities @ optimum.x).reshape(steps, k)[:, :n_dc] + self.arrived_kw
        self.q_kvar = x[:, n_dc : n_dc + self.n]
        if n_u:
            self.position = np.clip(x[:, n_dc + self.n :], self.lowest, self.highest)
        return optimum.bound, self.actions()

    def actions(self) -> np.ndarray:
        """(T, n_action) in [-1, 1], as ``Trajectory.actions``, and of the equipment the nearest whole positions."""
        actions, layout = super().actions(), action_layout(self.scenario)
        span = np.where(self.highest > self.lowest, self.highest - self.lowest, 1.0)
        shares = 2.0 * (np.rint(self.position) - self.lowest) / span - 1.0
        for group, entries in zip(self.groups, self._split(shares), strict=True):
            if group.device.kind in CHANNELS:
                actions[:, layout.is_channel(CHANNELS[group.device.kind])] = entries
        return self._with_set_points(actions)

    def _with_set_points(self, actions: np.ndarray) -> np.ndarray:
        """The actions with set points that lead to the planned positions, or the default ones before a replay."""
        s, layout = self.scenario, action_layout(self.scenario)
        setters = [group for group in self.groups if group.device.kind in SETTERS]
        if not setters:
            return actions
        if not len(self._tap):
            names = [channel.name for group in setters for channel in group.device.channels]
            entries = np.logical_or.reduce([layout.is_channel(name) for name in names])
            return np.where(entries, at_rest(s), actions)
        taps, on = self._tap.copy(), self._on.copy()
        for group, position in zip(self.groups, self._split(np.rint(self.position)), strict=True):
            (taps if group.are_taps else on)[:, group.rows] = position
        relays = acting_relays(s)
        for group in setters:
            device = group.device
            if group.are_taps:
                assert relays is not None
                relay_v = relays.volts(self.flows_at(taps[None], on[None]))
                planned = relay_set_points(device, relays, self._first_tap, taps, relay_v)
            else:
                lead = s.grid_control.capacitor_settings.delay_s / s.dt_s
                planned = bank_set_points(device, on[:, group.rows], lead)
            for channel, values in zip(device.channels, planned, strict=True):
                actions[:, layout.is_channel(channel.name)] = action_of(channel, values)
        return actions

    def ranges(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest positions, (T, n_u)."""
        steps = self.scenario.horizon
        return np.tile(self.lowest, (steps, 1)), np.tile(self.highest, (steps, 1))

    def _split(self, columns: np.ndarray) -> list[np.ndarray]:
        """The columns of each group of equipment."""
        return np.split(columns, np.cumsum([len(group.rows) for group in self.groups])[:-1], axis=-1)

    def _of_groups(self, taps: np.ndarray, on: np.ndarray) -> np.ndarray:
        """Of all the feeder's taps and switches (..., n) those of the groups, (..., n_u)."""
        columns = [(taps if group.are_taps else on)[..., group.rows] for group in self.groups]
        return np.concatenate(columns, axis=-1)

    def _control(self, copies: int) -> Control | None:
        """The equipment in each power flow of ``flows``: in the last ones each unknown position moved by itself."""
        taps, on = (np.tile(rows, (copies, 1, 1)) for rows in (self._tap, self._on))
        still = copies - self.n_further
        moved = np.tile(self.position, (copies, 1, 1))
        moved[np.arange(still, copies), :, np.arange(self.n_further)] += self._spans().T
        for group, positions in zip(self.groups, self._split(moved), strict=True):
            (taps if group.are_taps else on)[..., group.rows] = positions
        return self.acting(taps, on)

    def _spans(self) -> np.ndarray:
        """By how much each unknown position is moved, away from its nearer end, (T, n_further)."""
        upper = self.position > 0.5 * (self.lowest + self.highest)
        return np.where(upper, -_SPAN, _SPAN)[:, : self.n_further]

    def _around_positions(self, v_pu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Voltages where all unknowns are 0, (T, n_node), and their slopes by d, q and u, (T, n_node, k)."""
        s, linear = self.scenario, self.linear(v_pu)
        values = v_pu.reshape(-1, s.horizon, v_pu.shape[-1])
        by_u = np.moveaxis(values[len(values) - self.n_further :] - values[0], 0, -1) / self._spans()[:, None]
        v_at_zero = linear.at_zero - (by_u @ self.position[:, : self.n_further, None])[..., 0]
        return v_at_zero, np.ascontiguousarray(np.concatenate((linear.by_d, linear.by_q, by_u), axis=-1))

    def _linear_costs(
        self, v_pu: np.ndarray, dense: np.ndarray, quantities: sparse.csr_array
    ) -> tuple[np.ndarray, float]:
        """Of |x| = 2 max(x, 0) - x the last part, with x the deviation, and what is no hinge, and the constant.

        With a band b around a profile it is max(|x| - b, 0) = max(x - b, 0) + max(x + b, 0) - (x + b).
        """
        s, w, n_dc = self.scenario, self.scenario.cost.weights, self.scenario.datacenters.count
        price = w.voltage / v_pu.size
        c = (quantities.T @ (-price * dense.sum(axis=1)).ravel()).reshape(s.horizon, -1)
        backlog = np.full(s.horizon, w.backlog)
        backlog[-1] += w.leftover
        c[:, :n_dc] += backlog[:, None] / (s.datacenters.parameters.p_rated_kw.sum() or 1.0) / s.horizon
        c[:, n_dc : n_dc + self.n] += self._effort()
        constant = price * float((self.target_pu - v_pu - s.cost.uncharged_pu).sum())
        if self.n_further:
            c[-1, n_dc + self.n :] += self._switching()
            return c.ravel(), constant - self._switching() * float(self.rest.sum())
        moves = np.abs(np.diff(self.position, axis=0, prepend=self.rest[None])).sum()
        return c.ravel(), constant + self._switching() * float(moves)

    def _effort(self) -> np.ndarray:
        """Price of a kvar of each agent in a step."""
        return self.scenario.cost.weights.effort / self.n / self.s_rated_kva / self.scenario.horizon

    def _switching(self) -> float:
        """Price of a tap or a switching."""
        return self.scenario.cost.weights.switching / len(self.rest) / self.scenario.horizon

    def _of_voltages(self, v_pu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Prices and limits of the voltages' hinges: above their targets, above the band, below it."""
        w, band = self.scenario.cost.weights, self.scenario.cost.band_pu
        beyond = np.inf if self.keep_band else max(w.violation / v_pu.size, 1e-12)
        edges = [self.target_pu + edge - v_pu for edge in self.edges_pu]
        price = max(2.0 * w.voltage / v_pu.size / len(edges), 1e-12)
        h = np.repeat([*(price for _ in edges), beyond, beyond], v_pu.size)
        return h, np.concatenate([side.ravel() for side in (*edges, 1.0 + band - v_pu, v_pu - 1.0 + band)])

    def _of_steps(self, quantities: sparse.csr_array, k: int) -> tuple[Any, np.ndarray, np.ndarray]:
        """The other rows, with their prices and limits: of backlogs, work, reactive power, positions and moves."""
        s, n_dc, n_u, steps = self.scenario, self.scenario.datacenters.count, self.n_further, self.scenario.horizon
        identity: Any = sparse.identity(steps * k, format="csr")
        columns = np.arange(steps * k).reshape(steps, k)
        b, q, u = (columns[:, part].ravel() for part in np.split(np.arange(k), [n_dc, n_dc + self.n]))
        dc = s.datacenters.parameters
        top_kw = np.maximum(dc.p_dynamic_kw, self.arrived_kw)
        least_kw = np.minimum(top_kw * (dc.f_min_mhz / dc.f_max_mhz), self.arrived_kw)  # as in EpisodeProgram
        limit, work = np.maximum(self.q_limit_kvar, _NARROWEST).ravel(), quantities[b]
        parts: list[tuple[Any, Any, np.ndarray]] = [
            (-identity[b], np.inf, np.zeros(b.size)),
            (work, np.inf, np.maximum(top_kw - self.arrived_kw, 0.0).ravel() + _NARROWEST),
            (-work, np.inf, (self.arrived_kw - least_kw).ravel() + _NARROWEST),
            (identity[q], np.inf, limit),
            (-identity[q], np.inf, limit),
            *self._capability(work, identity[columns[:, n_dc : 2 * n_dc].ravel()], top_kw),
        ]
        effort = np.tile(2.0 * self._effort(), steps)
        if s.cost.weights.effort:
            parts.append((-identity[q], effort, np.zeros(q.size)))
        if n_u:
            parts += self._moves(identity, u)
        h = np.concatenate([np.broadcast_to(price, limits.shape) for _, price, limits in parts])
        return (
            sparse.csr_array(sparse.vstack([rows for rows, _, _ in parts])),
            h,
            np.concatenate([limits for *_, limits in parts]),
        )

    def _moves(self, identity: sparse.csr_array, u: np.ndarray) -> list[tuple[Any, Any, np.ndarray]]:
        """The rows of positions, within their range, and of their moves."""
        steps, n_u = self.scenario.horizon, self.n_further
        change = (sparse.identity(u.size) - sparse.eye(u.size, k=-n_u)) @ identity[u]
        before = np.concatenate((self.rest, np.zeros(u.size - n_u)))
        (low, high), most = (side.ravel() for side in self.ranges()), np.tile(self.most, steps)
        parts = [
            (identity[u], np.inf, high),
            (-identity[u], np.inf, -low),
            (change, np.inf, most + before),
            (-change, np.inf, most - before),
        ]
        if self._switching():
            parts.append((-change, 2.0 * self._switching(), -before))
        return parts

    def _capability(
        self, work: sparse.csr_array, q: sparse.csr_array, top_kw: np.ndarray
    ) -> list[tuple[Any, Any, np.ndarray]]:
        """The tangents of ``EpisodeProgram`` of the data centres' circles, those that power can come near."""
        n_dc, parts = self.scenario.datacenters.count, []
        s_rated_kva = np.maximum(self.s_rated_kva[:n_dc], self.base_kw + top_kw)
        most_kvar = self.q_limit_kvar[:, :n_dc]
        for theta in 0.5 * np.pi * np.arange(1, TANGENTS) / TANGENTS:
            cos, sin = np.cos(theta), np.sin(theta)
            room = s_rated_kva - cos * (self.base_kw + self.arrived_kw)
            near = np.flatnonzero(cos * (self.base_kw + top_kw) + sin * most_kvar > s_rated_kva)
            parts += [(cos * work[near] + sign * sin * q[near], np.inf, room.ravel()[near]) for sign in (1.0, -1.0)]
        return parts


def _group(scenario: Scenario, device: Any) -> Group:
    """The equipment of a group of agents."""
    if device.kind in CHANNELS:
        (channel,), rows = device.channels, list(device.rows)
        are_taps = device.kind == "tap_changer"
        most = scenario.dt_s / device.parameters.tap_delay_s if are_taps else np.ones(len(rows))
        return Group(device, are_taps, rows, channel.lowest, channel.highest, channel.rest, most)
    rows, feeder = [row for of_bank in device.members for row in of_bank], cast(Any, scenario.feeder)
    relays = acting_relays(scenario) if device.kind == SETTERS[0] else None
    if relays is None:
        zero = np.zeros(len(rows))
        return Group(device, False, rows, zero, zero + 1.0, feeder.base_capacitor_on[rows], zero + 1.0)
    settings = relays.settings
    further = scenario.dt_s / np.maximum(settings.tap_delay_s[rows], _SHORTEST_S)
    most = np.minimum(1.0 + further, np.maximum(settings.highest[rows] - settings.lowest[rows], 1.0))
    return Group(device, True, rows, settings.lowest[rows], settings.highest[rows], feeder.base_tap[rows], most)
