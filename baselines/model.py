"""What a controller with a model knows: how the voltage of every bus follows the agents' powers, and what it costs.

    V_i(t+1) = V_i(t) + sum_a R_ia (p_a(t) - p_a(t+1)) / V_i + X_ia (q_a(t+1) - q_a(t)) / V_i

R and X are LinDistFlow's (Baran and Wu 1989) of ``Scenario.model``, the feeder as controllers believe it. LinDistFlow
is linear in V^2, so each bus's slopes are divided by its voltage; p is drawn, q injected. Only changes are predicted:
what the feeder's other loads, its losses and an error of R and X do to the voltage stands in the measurement, so that
nothing of it is left in a steady state (offset-free, as J. B. Rawlings, D. Q. Mayne and M. Diehl, "Model predictive
control", 2017, section 1.5, do it with a disturbance model).

A measurement that is k steps old is one of the powers k steps ago, which the agents know: what they have done since is
added by the model. Where it is noisy, the part of it that is not the agents' is smoothed,

    V^_t = V' + g (V_t - V'),   V' = V^_{t-1} and what the agents' last change did to it
    g    = (sqrt(r^2 + 4 r) - r) / 2,  r = (sigma_w / sigma_v)^2

with the gain of a Kalman filter in its steady state for a random walk (R. E. Kalman, "A new approach to linear
filtering and prediction problems", 1960) whose step is that of the other loads' noise as the scenario tells it. Without
noise g = 1.
"""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import numpy as np

from dcgrid_env import LinearDvfs, Scenario, field_names
from dcgrid_env.baselines.controller import Local, LocalController


class Slopes(NamedTuple):
    """Change of every bus's voltage but the substation's with the agents' powers, around 1 p.u.

    One lane where all have the same placement.
    """

    by_p: np.ndarray
    """P.u. per kW drawn (negative), (lane, n_agent, n_bus - 1)."""
    by_q: np.ndarray
    """P.u. per kvar injected (positive), (lane, n_agent, n_bus - 1)."""


def slopes(scenario: Scenario, buses: np.ndarray) -> Slopes:
    """LinDistFlow's slopes of the believed feeder for agents at positions ``buses``, (lane, n_agent)."""
    buses = np.asarray(buses)
    if (buses == buses[:1]).all():
        buses = buses[:1]
    r, x = scenario.model.sensitivity()
    return Slopes(-r[buses, 1:] / 1000.0, x[buses, 1:] / 1000.0)


class Estimate(NamedTuple):
    """What is known of the feeder now, lanes first."""

    seen: Local
    """Observed, each field (lane, ..)."""
    v_pu: np.ndarray
    """Voltage of every bus but the substation, p.u., (lane, n_bus - 1)."""
    q_limit_kvar: np.ndarray
    """Observed reactive limit, kvar, (lane, n_agent)."""
    by_p: np.ndarray
    """Slopes at these voltages, as in :class:`Slopes`, (lane, n_agent, n_bus - 1)."""
    by_q: np.ndarray
    p_ref_kw: np.ndarray
    """p_ref of the last interval: the draw and what the queue has grown by, kW, (lane, n_dc)."""


class ModelController(LocalController):
    """Base of controllers with a model; they see all voltages (``observe="feeder"``). Subclasses write ``plan``."""

    name: ClassVar[str]
    observe: ClassVar[str] = "feeder"

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes.

        Raises
        ------
        ValueError
            For a scenario with another clock law, voltage cost or scope of observation than this can work with.
        """
        s = env_info
        if not isinstance(s.dvfs, LinearDvfs):
            raise ValueError(
                f"{self.name}: dvfs is {type(s.dvfs).__name__}, where power does not follow the work served; make the "
                "scenario with LinearDvfs()"
            )
        if s.voltage_cost != "l1":
            raise ValueError(f"{self.name}: voltage_cost is {s.voltage_cost!r}; it minimises 'l1' only")
        if s.observe != "feeder":
            raise ValueError(f"{self.name}: observe is {s.observe!r}; make the scenario with observe='feeder'")
        super().reset(s)
        names = field_names(s)
        widths = [len(names[agent]) for agent in s.agents]
        starts = np.cumsum([0, *widths])[:-1]
        self._limit_at = starts + names[s.agents[0]].index("q_limit")
        self._bus_at = np.arange(widths[0] - (s.feeder.n_bus - 1), widths[0])
        self._slopes: Slopes | None = None
        if s.datacenter_buses is not None or not s.n_datacenters:
            fixed = (*(s.datacenter_buses or ()), *s.inverter_buses)
            self.place(np.array([[s.feeder.index(bus) for bus in fixed]]))
        self._past: list[tuple[np.ndarray, np.ndarray]] = []
        self._v_smooth_pu: np.ndarray | None = None
        self._backlog_kws: np.ndarray | None = None
        self._gain = _gain(s)

    def place(self, buses: np.ndarray) -> None:
        """See :class:`Placed`."""
        self._slopes = slopes(self.scenario, buses)

    def control(self, seen: Local) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`LocalController`."""
        lead = seen.v_pu.shape[:-1]
        flat = Local(*(field.reshape(-1, field.shape[-1]) for field in seen))
        f_mhz, q_kvar = self.plan(self._estimate(flat))
        return f_mhz.reshape(*lead, -1), q_kvar.reshape(*lead, -1)

    def plan(self, now: Estimate) -> tuple[np.ndarray, np.ndarray]:
        """Clock of the data centres, MHz, (lane, n_dc), and reactive setpoints, kvar, (lane, n_agent)."""
        raise NotImplementedError

    def _local(self, joint: np.ndarray) -> Local:
        flat = joint.reshape(-1, joint.shape[-1]).astype(np.float64)
        self._v_measured_pu = 1.0 + (self.scenario.band_pu or 1.0) * flat[:, self._bus_at]
        self._q_limit_kvar = flat[:, self._limit_at] * self._q_scale
        return super()._local(joint)

    def _estimate(self, seen: Local) -> Estimate:
        """Voltages now, from a measurement that may be old and noisy."""
        s, lanes = self.scenario, len(seen.v_pu)
        known = self._slopes
        if known is None:
            raise ValueError(
                f"{self.name}: the data centres of {s.name} are drawn in each episode; call place(buses) after reset "
                "with the positions of the agents' buses, (lane, n_agent)"
            )
        if len(known.by_p) not in (1, lanes):
            raise ValueError(f"{self.name}: place was told of {len(known.by_p)} lanes and {lanes} are observed")
        by_p, by_q = (by / np.maximum(self._v_measured_pu, 0.5)[:, None] for by in known)
        powers = np.stack((seen.p_kw, seen.q_kvar))
        past = [*(self._past or [powers] * (s.measurement_delay + 1)), powers]
        v = self._v_measured_pu
        if self._v_smooth_pu is not None:
            expected = self._v_smooth_pu + _moved(by_p, by_q, past[1] - past[0])
            v = expected + self._gain * (v - expected)
        self._v_smooth_pu, self._past = v, past[1:]
        before = 0.0 * seen.backlog_kws if self._backlog_kws is None else self._backlog_kws
        self._backlog_kws = seen.backlog_kws
        asked = np.maximum(seen.p_kw[:, : s.n_datacenters] + (seen.backlog_kws - before) / s.dt_s, 0.0)
        return Estimate(seen, v + _moved(by_p, by_q, powers - past[1]), self._q_limit_kvar, by_p, by_q, asked)


def _moved(by_p: np.ndarray, by_q: np.ndarray, change: np.ndarray) -> np.ndarray:
    """What a change of p (first) and q, (2, lane, n_agent), does to the voltages, (lane, n_bus - 1)."""
    return np.matmul(change[0][:, None], by_p)[:, 0] + np.matmul(change[1][:, None], by_q)[:, 0]


def _gain(scenario: Scenario) -> float:
    """Share of a new measurement that is believed."""
    s, sigma_v = scenario, scenario.voltage_noise_pu
    if sigma_v == 0.0:
        return 1.0
    r, x = s.model.sensitivity()
    each = (r * s.feeder.p_load_kw + x * s.feeder.q_load_kvar) / 1000.0
    step = s.load_sigma * np.sqrt(2.0 * (1.0 - s.load_rho**s.dt_s) * (each[1:] ** 2).sum(axis=1).mean())
    ratio = (step / sigma_v) ** 2
    return float(0.5 * (np.sqrt(ratio * ratio + 4.0 * ratio) - ratio))
