"""What a controller with a model knows: how the voltage of every bus follows the agents' powers.

    V_i(t+1) = V_i(t) - (sum_a R_ia (p_a(t+1) - p_a(t)) - X_ia (q_a(t+1) - q_a(t))) / V_i(t)

R and X are LinDistFlow's (M. E. Baran and F. F. Wu 1989) of ``Scenario.model``, the feeder as controllers believe it;
on a three-phase feeder the derivatives of its nodes' voltages around the base case, across phases. LinDistFlow is
linear in V^2, so a bus's slopes are divided by its voltage, which those of a three-phase feeder already are; p is
drawn, q injected. Only changes are predicted. The measurement contains the effect of other loads, losses and errors of
R and X, so no offset remains in a steady state. This is the disturbance model of J. B. Rawlings, D. Q. Mayne and M.
Diehl, "Model predictive control: theory, computation, and design", 2017, section 1.5.

A measurement that is k steps old belongs to the agents' powers k steps ago, which they know. The model adds the later
changes. With noise, the part of the measurement that is not the agents' is smoothed,

    V^_t = V' + g (V_t - V')                                 V': V^_{t-1} and what the agents' last change did to it
    g    = (sqrt(r^2 + 4 r) - r) / 2                         r = (sigma_w / sigma_v)^2

with the gain of a Kalman filter in its steady state for a random walk (R. E. Kalman, "A new approach to linear
filtering and prediction problems", 1960). sigma_v is the measurement's noise. sigma_w is the root mean square over
buses of the voltage change in a step by the other loads' noise. Both come from the scenario. Without noise g = 1.
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import numpy as np

from dcgrid_env import (
    Feeder,
    LinearDvfs,
    Scenario,
    believed_sensitivity,
    field_names,
    sensitivity_to_agents,
    under_own_control,
)
from dcgrid_env.baselines.controller import Local, LocalController, require_known_devices, require_work_draws

_V_LEAST_PU = 0.5  # no slope is steeper than at this voltage
_GAIN_LEAST = 0.05  # an error of R and X must show, however quiet the loads are


class Slopes(NamedTuple):
    """Change of the voltage of every bus but the substation with the agents' powers, around 1 p.u.

    One environment where all environments have the same placement.
    """

    by_p: np.ndarray
    """P.u. per kW drawn (negative), (row, n_agent, n_load_node)."""
    by_q: np.ndarray
    """P.u. per kvar injected (positive), (row, n_agent, n_load_node)."""


def slopes(scenario: Scenario, buses: np.ndarray) -> Slopes:
    """Slopes of the believed feeder for agents at positions ``buses`` of ``bus_ids``, (row, n_agent)."""
    if (buses == buses[:1]).all():
        buses = buses[:1]
    r, x = (by[..., scenario.feeder.load_slice] for by in sensitivity_to_agents(scenario, buses))
    return Slopes(-r / 1000.0, x / 1000.0)


class Estimate(NamedTuple):
    """What a controller with a model takes the grid's state to be, for each environment of the batch."""

    local: Local
    """Local observations of the agents, each field (row, ..)."""
    v_pu: np.ndarray
    """Voltage of every bus but the substation, p.u., (row, n_load_node)."""
    q_limit_kvar: np.ndarray
    """Reactive limit as observed, kvar, (row, n_agent)."""
    by_p: np.ndarray
    """Slopes at these voltages, as in :class:`Slopes`, for each environment."""
    by_q: np.ndarray
    p_ref_kw: np.ndarray
    """p_ref of the last interval, which is the draw and what the queue grew by, kW, (row, n_dc)."""


class ModelController(LocalController):
    """Base of controllers with a model, which see all voltages; subclasses write ``plan``.

    A subclass that sees less sets ``observe`` and computes the voltages of all buses in ``_measured``. If buses are
    drawn, call ``place`` after ``reset``, as ``rollout`` does.
    """

    name: ClassVar[str]
    """In messages."""
    observe: ClassVar[str] = "feeder"

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes.

        Raises
        ------
        ValueError
            For a scenario with other devices, or another scope of observation, clock law or cost, than these work with.
        """
        s = under_own_control(env_info)
        require_known_devices(self.name, s)
        require_work_draws(self.name, s)
        if s.sensing.observe != self.observe:
            raise ValueError(
                f"{self.name}: observe is {s.sensing.observe!r}; make the scenario with observe={self.observe!r}"
            )
        if not isinstance(s.datacenters.clock_law, LinearDvfs):
            raise ValueError(
                f"{self.name}: datacenters.clock_law is {type(s.datacenters.clock_law).__name__}, under which power is "
                "not the work served; make the scenario with LinearDvfs()"
            )
        if s.cost.voltage != "l1":
            raise ValueError(f"{self.name}: cost.voltage is {s.cost.voltage!r}; make the scenario with 'l1'")
        # Equipment is moved by its own controls, or by agents that are not these: switching is not theirs to price.
        priced = [name for name in s.cost.weights.unmodelled if name != "switching"]
        if priced:
            weight = getattr(s.cost.weights, priced[0])
            raise ValueError(f"{self.name}: weights.{priced[0]} is {weight:g}, which it does not minimise; set it to 0")
        super().reset(env_info)
        names = field_names(s)
        widths = [len(names[agent]) for agent in s.agents]
        self._limit_at = np.cumsum([0, *widths])[:-1] + names[s.agents[0]].index("q_limit")
        self._width = widths[0]
        self._slopes: Slopes | None = None
        self._fixed_buses: np.ndarray | None = None
        if s.datacenters.buses is not None or not s.datacenters.count:
            fixed = (*(s.datacenters.buses or ()), *s.inverters.buses)
            self._fixed_buses = np.array([[s.feeder.index(bus) for bus in fixed]])
            self._slopes = slopes(s, self._fixed_buses)
        self._gain = _gain(s)
        self._past: list[np.ndarray] = []
        self._v_smooth_pu: np.ndarray | None = None
        self._backlog_kws: np.ndarray | None = None

    def place(self, buses: np.ndarray) -> None:
        """See :class:`NeedsPlacement`."""
        self._slopes = slopes(self.scenario, np.asarray(buses)[:, self._equipment.is_other])

    def plan(self, now: Estimate) -> tuple[np.ndarray, np.ndarray]:
        """Clock of the data centres, MHz, (row, n_dc), and reactive setpoints, kvar, (row, n_agent)."""
        raise NotImplementedError

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`LocalController`."""
        lead, n_env = local.v_pu.shape[:-1], len(self._flat)
        flat = Local(*(field.reshape(n_env, field.shape[-1]) for field in local))
        f_mhz, q_kvar = self.plan(self._estimate(flat))
        return f_mhz.reshape(*lead, f_mhz.shape[-1]), q_kvar.reshape(*lead, q_kvar.shape[-1])

    def _local(self, joint: np.ndarray) -> Local:
        # What these see beside the local fields is kept for ``control``, which is given the local ones alone.
        self._flat = joint.reshape(-1, joint.shape[-1]).astype(np.float64)
        self._q_limit_kvar = self._flat[:, self._limit_at] * self._q_scale
        return super()._local(joint)

    def _measured(self, local: Local, then: np.ndarray) -> np.ndarray:
        """Voltage of every bus but the substation when it was measured, p.u., (row, n_load_node).

        ``then`` has the agents' p and q at that time, kW and kvar, (2, row, n_agent).
        """
        of_buses = self._flat[:, self._width - len(self.scenario.feeder.load_nodes) : self._width]
        return 1.0 + (self.scenario.cost.band_pu or 1.0) * of_buses

    def _estimate(self, local: Local) -> Estimate:
        """Voltages now, of a measurement that may be old and noisy."""
        s, powers = self.scenario, np.stack((local.p_kw, local.q_kvar))
        # Powers from the step before the measured one until now.
        past = [*(self._past or [powers] * (s.sensing.delay_steps + 1)), powers]
        v = self._measured(local, past[1])
        by_p, by_q = self._placed_slopes(len(v))
        if isinstance(s.feeder, Feeder):
            by_p, by_q = (by / np.maximum(v, _V_LEAST_PU)[:, None] for by in (by_p, by_q))
        else:
            by_p, by_q = (np.broadcast_to(by, (len(v), *by.shape[1:])) for by in (by_p, by_q))
        if self._v_smooth_pu is not None:
            expected = self._v_smooth_pu + _moved(by_p, by_q, past[1] - past[0])
            v = expected + self._gain * (v - expected)
        self._v_smooth_pu, self._past = v, past[1:]
        before = 0.0 * local.backlog_kws if self._backlog_kws is None else self._backlog_kws
        self._backlog_kws = local.backlog_kws
        p_ref = np.maximum(local.p_kw[:, : s.datacenters.count] + (local.backlog_kws - before) / s.dt_s, 0.0)
        return Estimate(local, v + _moved(by_p, by_q, powers - past[1]), self._q_limit_kvar, by_p, by_q, p_ref)

    def _placed_slopes(self, n_env: int) -> Slopes:
        """The slopes at the agents' buses; ValueError without ``place``, or for a batch of another size."""
        if self._slopes is None:
            raise ValueError(
                f"{self.name}: {self.scenario.name} draws the data centres' buses in each episode; call place(buses) "
                "after reset with the agents' positions in bus_ids, (row, n_agent)"
            )
        n_placed = len(self._slopes.by_p)
        if n_placed not in (1, n_env):
            raise ValueError(
                f"{self.name}: buses were placed in {n_placed} environments and {n_env} are observed; call place again"
            )
        return self._slopes


def _moved(by_p: np.ndarray, by_q: np.ndarray, change: np.ndarray) -> np.ndarray:
    """What a change of p and of q, stacked (2, row, n_agent), does to the voltages, p.u., (row, n_load_node)."""
    return np.matmul(change[0][:, None], by_p)[:, 0] + np.matmul(change[1][:, None], by_q)[:, 0]


def _gain(scenario: Scenario) -> float:
    """Weight of the difference between a new measurement and its prediction, 0 .. 1."""
    s, sigma_v = scenario, scenario.sensing.noise_pu
    if sigma_v == 0.0:
        return 1.0
    r, x = believed_sensitivity(s)
    p_kw, q_kvar = (np.bincount(s.feeder.leg_node, load) for load in (s.feeder.p_load_kw, s.feeder.q_load_kvar))
    drop = (r * p_kw + x * q_kvar)[s.feeder.load_slice] / 1000.0
    step = 2.0 * (1.0 - s.background.load_rho**s.dt_s) * s.background.load_sigma**2
    ratio = step * (drop**2).sum(axis=1).mean() / sigma_v**2
    return max(float(0.5 * (np.sqrt(ratio * ratio + 4.0 * ratio) - ratio)), _GAIN_LEAST)
