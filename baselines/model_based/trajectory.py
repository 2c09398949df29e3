"""An episode that is known beforehand, and its voltages as linear functions of what is done, around a trajectory."""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env import Control, Forecast, Recorder, Scenario, action_layout, nodes_by_bus, solver_for
from dcgrid_env.baselines.model_based.voltage_rows import Linear

_SPAN = 1.0  # kW and kvar by which the power flow is tried to find its slopes


class Trajectory:
    """Work served and reactive power in every step of an episode, and the grid linearised around them.

    Agents are those with a converter, data centres first, n of them.
    """

    n_further = 0
    """Power flows beside those by which ``_linear`` finds slopes."""
    has_own_taps = False
    """Whether taps change by themselves, as what is done makes them."""

    def __init__(self, scenario: Scenario, episode: Forecast) -> None:
        s, dc, n_dc = scenario, scenario.datacenter, scenario.n_datacenters
        self.scenario, self.episode = s, episode
        self.base_kw = np.minimum(episode.p_ref_kw, dc.p_idle_kw)
        self.arrived_kw = np.maximum(episode.p_ref_kw - dc.p_idle_kw, 0.0)
        self.s_rated_kva = np.concatenate((dc.s_rated_kva, s.inverter.s_rated_kva))
        self.n = len(self.s_rated_kva)
        # It begins with serving all work as it arrives, without reactive power.
        self.served_kw, self.q_kvar = self.arrived_kw, np.zeros((s.horizon, self.n))
        room = np.sqrt(np.maximum(self.s_rated_kva[n_dc:] ** 2 - episode.p_inverter_kw**2, 0.0))
        self.q_limit_kvar = np.tile(s.q_scale_kvar[: self.n], (s.horizon, 1))
        self.q_limit_kvar[:, n_dc:] = np.minimum(self.q_limit_kvar[:, n_dc:], room)
        self.q_limit_kvar *= episode.available[:, : self.n]
        self._first_tap, self._tap, self._on = np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0))

    def follow(self, replayed: Recorder) -> None:
        """Take the taps and switches of a three-phase feeder's equipment as they were in a replay."""
        phases: Any = replayed.lane(0).three_phase
        missing = self.scenario.horizon + 1 - len(phases.equipment.regulators.tap)  # the replay ended in a collapse
        taps, on = (
            np.concatenate((rows[1:], np.repeat(rows[-1:], missing, axis=0)))
            for rows in (phases.equipment.regulators.tap, phases.equipment.banks.on)
        )
        self._first_tap, self._tap, self._on = phases.equipment.regulators.tap[0], taps, on

    def _around(self) -> Any:
        """Power flows (1 + n_dc + n_agent + n_further, T), flattened.

        They are of the trajectory, with each power moved by itself, and with the powers of the trajectory again.
        """
        s, episode, n_dc = self.scenario, self.episode, self.scenario.n_datacenters
        p_agent = np.concatenate((self.base_kw + self.served_kw, -episode.p_inverter_kw), axis=1)
        p_agent *= episode.available[:, : self.n]
        p_kw, q_kvar = episode.p_load_kw.copy(), episode.q_load_kvar.copy()
        shares = self._shares()
        p_kw += p_agent @ shares
        q_kvar -= self.q_kvar @ shares
        moved = _SPAN * shares
        none = np.zeros((1, s.feeder.n_leg))
        still = np.zeros((self.n_further, s.feeder.n_leg))
        by_p = np.concatenate((none, moved[:n_dc], 0.0 * moved, still))[:, None]
        by_q = np.concatenate((none, 0.0 * moved[:n_dc], moved, still))[:, None]
        loads = (p_kw + by_p).reshape(-1, s.feeder.n_leg), (q_kvar - by_q).reshape(-1, s.feeder.n_leg)
        solution = solver_for(s.feeder, s.power_flow)(s.feeder, *loads, s.v0_pu, self._control(len(by_p)))
        unsolved = np.flatnonzero(~solution.converged.reshape(-1, s.horizon).all(axis=0))
        if unsolved.size:
            raise ValueError(
                f"hindsight of scenario {s.name!r}: the power flow around the trajectory has no solution at step "
                f"{unsolved[0] + 1}; give the feeder less load"
            )
        return solution

    def _linear(self, values: np.ndarray) -> Linear:
        """What is measured in the flows of ``_around``, (flow, n), as a linear function of the unknowns d and q."""
        s, n_dc = self.scenario, self.scenario.n_datacenters
        values = values.reshape(-1, s.horizon, values.shape[-1])
        # What a tripped data centre draws, the grid does not see.
        drawn = np.concatenate((self.episode.available[:, :n_dc], np.ones((s.horizon, self.n))), axis=1)
        moved_by_one = values[1 : 1 + n_dc + self.n]
        slopes = np.moveaxis(moved_by_one - values[0], 0, -1) / _SPAN * drawn[:, None]
        by_d, by_q = slopes[..., :n_dc], slopes[..., n_dc:]
        moved = np.einsum("tnd,td->tn", by_d, self.served_kw) + np.einsum("tna,ta->tn", by_q, self.q_kvar)
        return Linear(values[0] - moved, by_d, by_q)

    def _shares(self) -> np.ndarray:
        """Share of each agent's power that each leg draws, (n_agent, n_leg)."""
        s = self.scenario
        nodes = nodes_by_bus(s)[np.arange(self.n), self.episode.buses[: self.n]]
        shares = np.zeros((self.n, s.feeder.n_leg))
        np.add.at(shares, (np.arange(self.n)[:, None], s.feeder.first_device_leg + nodes), 1.0 / nodes.shape[1])
        return shares

    def _control(self, copies: int) -> Control | None:
        """Taps and switches in each step of the episode, and as many copies of them; None before they are followed."""
        if not len(self._tap):
            return None
        return self._acting(*(np.tile(rows, (copies, 1, 1)) for rows in (self._tap, self._on)))

    def _acting(self, taps: np.ndarray, on: np.ndarray) -> Control:
        """What equipment is to the power flow, of taps and switches in each step, (flow, T, n); flattened."""
        if self.episode.capacitor_on is not None:
            on = on * self.episode.capacitor_on
        taps, on = (rows.reshape(-1, rows.shape[-1]) for rows in (taps, on))
        return Control(self.scenario.feeder.tap_ratio(taps), None, on)

    def actions(self) -> np.ndarray:
        """(T, n_action) in [-1, 1]: the clock whose ceiling is the work served, and shares of the reactive limit."""
        s, dc = self.scenario, self.scenario.datacenter
        ceiling_kw = np.maximum(dc.p_dynamic_kw, self.arrived_kw)
        f_mhz = np.clip(self.served_kw / ceiling_kw * dc.f_max_mhz, dc.f_min_mhz, dc.f_max_mhz)
        span = np.where(dc.f_max_mhz > dc.f_min_mhz, dc.f_max_mhz - dc.f_min_mhz, 1.0)
        scale = s.q_scale_kvar[: self.n]
        q = self.q_kvar / np.where(scale > 0, scale, 1.0)
        clock = 2.0 * (f_mhz - dc.f_min_mhz) / span - 1.0
        return np.clip(action_layout(s).joint(clock=clock, q=q), -1.0, 1.0)
