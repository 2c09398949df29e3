"""An episode that is known beforehand, and its voltages as linear functions of what is done, around a trajectory."""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env import Control, Forecast, Recorder, Scenario, action_layout, nodes_by_bus, solver_for
from dcgrid_env.baselines.model_based.storage_rows import storages_of
from dcgrid_env.baselines.model_based.voltage_rows import Linear
from dcgrid_env.baselines.model_based.work_rows import WorkRows
from dcgrid_env.devices import converter

_SPAN = 1.0  # kW and kvar by which the power flow is tried to find its slopes


class HindsightError(ValueError):
    """A scenario that hindsight does not plan, or an episode for which it has no solution."""


class Trajectory:
    """What is done in every step of an episode, and the grid linearised around it: work served, draws, reactive power.

    Agents are those with a converter, n of them: data centres, inverters, storages. The unknown d is work served, and
    behind it the draws of the storages, (T, n_d).
    """

    n_further = 0
    """Power flows in addition to those by which ``linear`` finds slopes."""

    def __init__(self, scenario: Scenario, episode: Forecast) -> None:
        s, dc, n_dc = scenario, scenario.datacenters.parameters, scenario.datacenters.count
        self.scenario, self.episode = s, episode
        self.base_kw = np.minimum(episode.p_ref_kw, dc.p_idle_kw)
        self.arrived_kw = np.maximum(episode.p_ref_kw - dc.p_idle_kw, 0.0)
        group = storages_of(s)
        self.n_storages = 0 if group is None else group.count
        converters = np.zeros(0) if group is None else group.converter_kva
        self.s_rated_kva = np.concatenate((dc.s_rated_kva, s.inverters.parameters.s_rated_kva, converters))
        self.n = len(self.s_rated_kva)
        self.is_active = np.arange(self.n) < n_dc
        """Which agents have an unknown d, (n,)."""
        self.is_active |= np.arange(self.n) >= self.n - self.n_storages
        self.storage_kw = np.zeros((s.horizon, self.n_storages))
        """Draw of the storages, kW, (T, n_storages)."""
        self.work_rows = WorkRows(s, self.arrived_kw, episode.available)
        self.moved_kw = 0.0 * self.arrived_kw
        """Work that each site receives less what it sends, kW, (T, n_dc)."""
        # It begins with serving all work as it arrives, without reactive power.
        self.served_kw, self.q_kvar = self.arrived_kw, np.zeros((s.horizon, self.n))
        inverters = slice(n_dc, self.n - self.n_storages)
        self.q_limit_kvar = np.tile(s.q_scale_kvar[: self.n], (s.horizon, 1))
        self.q_limit_kvar[:, inverters] = converter.limit(
            self.s_rated_kva[inverters], s.q_scale_kvar[inverters], episode.p_inverter_kw
        )
        self.q_limit_kvar *= episode.available[:, : self.n]
        self._first_tap, self._first_on = np.zeros(0), np.zeros(0)
        self._tap, self._on = np.zeros((0, 0)), np.zeros((0, 0))

    def follow(self, replayed: Recorder) -> None:
        """Take the taps and switches of a three-phase feeder's equipment as they were in a replay."""
        phases: Any = replayed.series(0).three_phase
        missing = self.scenario.horizon + 1 - len(phases.equipment.regulators.tap)  # the replay ended in a collapse
        taps, on = (
            np.concatenate((rows[1:], np.repeat(rows[-1:], missing, axis=0)))
            for rows in (phases.equipment.regulators.tap, phases.equipment.banks.on)
        )
        self._first_tap, self._first_on = phases.equipment.regulators.tap[0], phases.equipment.banks.on[0]
        self._tap, self._on = taps, on

    def retrace(self, replayed: Recorder) -> None:
        """Do what was done in a replay to its end; it moved no work to other sites."""
        series, n_dc = replayed.series(0), self.scenario.datacenters.count
        self.served_kw = series.p_kw[:, :n_dc] - self.base_kw
        self.storage_kw = series.p_kw[:, self.n - self.n_storages :]
        self.q_kvar, self.moved_kw = series.q_kvar, 0.0 * self.arrived_kw

    @property
    def taps(self) -> np.ndarray:
        """Taps at t = 0 and in each step, (1 + T, n_regulator), as they were followed."""
        return np.concatenate((self._first_tap[None], self._tap))

    def loads(self) -> tuple[np.ndarray, np.ndarray]:
        """Active and reactive power of all legs in each step of the trajectory, kW and kvar, (T, n_leg)."""
        episode, shares = self.episode, self._shares()
        p_agent = np.concatenate((self.base_kw + self.served_kw, -episode.p_inverter_kw, self.storage_kw), axis=1)
        p_agent *= episode.available[:, : self.n]
        return episode.p_load_kw + p_agent @ shares, episode.q_load_kvar - self.q_kvar @ shares

    def flows(self) -> Any:
        """Power flows (1 + n_d + n_agent + n_further, T), flattened.

        They are of the trajectory, with each power moved by itself, and with the powers of the trajectory again.
        """
        s, (p_kw, q_kvar), moved = self.scenario, self.loads(), _SPAN * self._shares()
        zero = np.zeros((1, s.feeder.n_leg))
        still = np.zeros((self.n_further, s.feeder.n_leg))
        active = moved[self.is_active]
        by_p = np.concatenate((zero, active, 0.0 * moved, still))[:, None]
        by_q = np.concatenate((zero, 0.0 * active, moved, still))[:, None]
        loads = (p_kw + by_p).reshape(-1, s.feeder.n_leg), (q_kvar - by_q).reshape(-1, s.feeder.n_leg)
        solution = solver_for(s.feeder, s.power_flow)(s.feeder, *loads, s.source_voltage_pu, self._control(len(by_p)))
        unsolved = np.flatnonzero(~solution.converged.reshape(-1, s.horizon).all(axis=0))
        if unsolved.size:
            raise HindsightError(
                f"hindsight of scenario {s.name!r}: the power flow around the trajectory has no solution at step "
                f"{unsolved[0] + 1}; give the feeder less load"
            )
        return solution

    def flows_at(self, taps: np.ndarray, on: np.ndarray | None = None) -> Any:
        """Power flows of the trajectory under other taps and switches, (flow, T, n), flattened."""
        s, copies = self.scenario, len(taps)
        p_kw, q_kvar = (np.tile(load, (copies, 1)) for load in self.loads())
        control = self.acting(taps, np.tile(self._on, (copies, 1, 1)) if on is None else on)
        return solver_for(s.feeder, s.power_flow)(s.feeder, p_kw, q_kvar, s.source_voltage_pu, control)

    def linear(self, values: np.ndarray) -> Linear:
        """What is measured in the flows of ``flows``, (flow, n), as a linear function of the unknowns d and q."""
        s, n_d = self.scenario, self.scenario.datacenters.count + self.n_storages
        values = values.reshape(-1, s.horizon, values.shape[-1])
        # What a tripped data centre draws, the grid does not see.
        available = self.episode.available[:, : self.n][:, self.is_active]
        drawn = np.concatenate((available, np.ones((s.horizon, self.n))), axis=1)
        moved_by_one = values[1 : 1 + n_d + self.n]
        slopes = np.moveaxis(moved_by_one - values[0], 0, -1) / _SPAN * drawn[:, None]
        by_d, by_q = slopes[..., :n_d], slopes[..., n_d:]
        d = np.concatenate((self.served_kw, self.storage_kw), axis=1)
        moved = np.einsum("tnd,td->tn", by_d, d) + np.einsum("tna,ta->tn", by_q, self.q_kvar)
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
        return self.acting(*(np.tile(rows, (copies, 1, 1)) for rows in (self._tap, self._on)))

    def acting(self, taps: np.ndarray, on: np.ndarray) -> Control:
        """Inputs of equipment to the power flow by taps and switches in each step, (flow, T, n); flattened."""
        if self.episode.capacitor_on is not None:
            on = on * self.episode.capacitor_on
        taps, on = (rows.reshape(rows.shape[0] * rows.shape[1], -1) for rows in (taps, on))
        return Control(self.scenario.feeder.tap_ratio(taps), None, on)

    def actions(self) -> np.ndarray:
        """(T, n_action) in [-1, 1]: clocks whose ceiling is the work served, draws of storages, reactive shares."""
        s, dc = self.scenario, self.scenario.datacenters.parameters
        ceiling_kw = np.maximum(dc.p_dynamic_kw, self.arrived_kw)
        f_mhz = np.clip(self.served_kw / ceiling_kw * dc.f_max_mhz, dc.f_min_mhz, dc.f_max_mhz)
        span = np.where(dc.f_max_mhz > dc.f_min_mhz, dc.f_max_mhz - dc.f_min_mhz, 1.0)
        scale = s.q_scale_kvar[: self.n]
        q = self.q_kvar / np.where(scale > 0, scale, 1.0)
        clock = 2.0 * (f_mhz - dc.f_min_mhz) / span - 1.0
        layout, storages = action_layout(s), storages_of(s)
        channels = {"clock": clock, "q": q[:, layout.reactive[: self.n] >= 0]}
        if storages is not None:
            channels["p"] = self.storage_kw / storages.p_scale_kw
        if self.work_rows.routing is not None:
            channels["route"] = self.work_rows.route(self.moved_kw)
        return np.clip(layout.joint(**channels), -1.0, 1.0)
