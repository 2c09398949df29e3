"""Model predictive control: each second the cost of the next steps is minimised and the first step of it is done.

The program is ``lookahead``'s, the model that of ``model``: the measured voltages and what the agents' change does to
them. p_ref of the next step is observed. Beyond it, and where the scenario hides it,

    p_ref(t + k) = mean + exp(-(k - 1) dt / tau) (p_ref(t + 1) - mean)

with the mean of what the site has drawn so far; an infinite tau is persistence. Other loads are taken to stay. What
waits at the end of the horizon is charged as if it waited ``wait_s`` longer. A horizon of one step is one-step MPC.
(J. B. Rawlings, D. Q. Mayne, M. Diehl, "Model predictive control: theory, computation, and design", 2017.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.baselines.checks import require_non_negative
from dcgrid_env.baselines.lookahead import Iterate, Program, moved_on, solve
from dcgrid_env.baselines.model import Estimate, ModelController


@dataclass
class Mpc(ModelController):
    """Receding-horizon control on the linear model."""

    horizon: int = 8
    wait_s: float = 10.0
    forecast_s: float = 14.0
    rounds: int = 60

    name: ClassVar[str] = "mpc"

    def __post_init__(self) -> None:
        require_non_negative(self.name, wait_s=self.wait_s)
        for field in ("horizon", "rounds"):
            value = getattr(self, field)
            if not (isinstance(value, int) and value >= 1):
                raise ValueError(f"{self.name}: {field} is {value!r}; give a whole number >= 1")
        if not self.forecast_s > 0:
            raise ValueError(f"{self.name}: forecast_s is {self.forecast_s!r}; give a time > 0, infinite to persist")

    def reset(self, env_info: Scenario) -> None:
        """See :class:`ModelController`."""
        super().reset(env_info)
        s, w, dc = env_info, env_info.weights, env_info.datacenter
        n_bus, steps = s.feeder.n_bus - 1, self.horizon
        self._size = np.concatenate((dc.p_dynamic_kw, s.inverter.s_rated_kva))
        self._rated = np.concatenate((dc.s_rated_kva, s.inverter.s_rated_kva))
        price = np.full((steps, 1), w.backlog)
        price[-1] += w.backlog * self.wait_s / s.dt_s
        self._price = price * dc.p_dynamic_kw * s.dt_s / (dc.p_rated_kw.sum() or 1.0)
        self._weights = (w.voltage / n_bus, w.violation / n_bus, w.effort / s.n_agents * self._size / self._rated)
        self._last: Iterate | None = None
        self._sum_kw: np.ndarray | float = 0.0
        self._count = 0

    def plan(self, now: Estimate) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`ModelController`."""
        s, dc, n_dc = self.scenario, self.scenario.datacenter, self.scenario.n_datacenters
        p_ref_kw = self._forecast(now)
        program, ceiling = self._program(now, p_ref_kw)
        self._last = solve(program, None if self._last is None else moved_on(self._last), self.rounds)
        first = self._last.y[:, 0]
        share = first[:, :n_dc] / ceiling[:, 0]
        # Where all work is to be served the clock may as well be at its top: more may come than was forecast.
        share = np.where(first[:, :n_dc] >= program.work[:, 0] - 1e-3, 1.0, share)
        return np.clip(share * s.f_max_mhz, s.f_min_mhz, s.f_max_mhz), first[:, n_dc:] * self._size

    def _forecast(self, now: Estimate) -> np.ndarray:
        """p_ref of the steps ahead, kW, (lane, step, n_dc)."""
        s = self.scenario
        known = [now.p_ref_kw, now.seen.p_ref_next_kw] if s.preview else [now.p_ref_kw]
        self._sum_kw, self._count = self._sum_kw + now.p_ref_kw, self._count + 1
        mean = (self._sum_kw + known[-1] * s.preview) / (self._count + s.preview)
        ahead = np.arange(self.horizon) + (not s.preview)
        stays = np.exp(-ahead * s.dt_s / self.forecast_s)[:, None]
        return (mean[:, None] + stays * (known[-1] - mean)[:, None])

    def _program(self, now: Estimate, p_ref_kw: np.ndarray) -> Program:
        s, dc, n_dc, seen = self.scenario, self.scenario.datacenter, self.scenario.n_datacenters, now.seen
        size, steps = self._size[:n_dc], self.horizon
        base = np.minimum(p_ref_kw, dc.p_idle_kw)
        coming = np.maximum(p_ref_kw - dc.p_idle_kw, 0.0)
        ceiling = np.maximum(dc.p_dynamic_kw, coming)
        queued = seen.backlog_kws / s.dt_s
        work = queued[:, None] + np.cumsum(coming, axis=1)
        at_hand = coming + queued[:, None] * (np.arange(steps) == 0)[:, None]
        low = np.minimum(ceiling * (s.f_min_mhz / s.f_max_mhz), at_hand)
        high = ceiling.copy()
        high[:, 0] = np.minimum(high[:, 0], at_hand[:, 0])
        by_p = now.by_p[:, :n_dc]
        # At no reactive power and no work served.
        change_kw = base - seen.p_kw[:, None, :n_dc]
        offset = now.v_pu[:, None] - 1.0 + np.matmul(change_kw, by_p)
        offset -= np.matmul(seen.q_kvar[:, None], now.by_q)
        limit = self._limit(now)
        voltage, violation, effort = self._weights
        return Program(
            offset=offset,
            slopes=np.concatenate((by_p * size[:, None], now.by_q * self._size[:, None]), axis=1),
            base=base / size,
            low=low / size,
            high=high / size,
            s_rated=self._rated[:n_dc] / size,
            q_high=limit / self._size,
            work=work / size,
            price=self._price,
            voltage=voltage,
            violation=violation,
            effort=effort,
            band_pu=s.band_pu,
        ), ceiling/size

    def _limit(self, now: Estimate) -> np.ndarray:
        """Reactive limit beside the circle, kvar, (lane, n_agent): an inverter's as observed, a site's its own.

        A site whose limit is 0 though its converter has room is out of order.
        """
        n_dc = self.scenario.n_datacenters
        limit = now.q_limit_kvar.copy()
        out = (limit[:, :n_dc] <= 0.0) & (now.seen.p_kw[:, :n_dc] < 0.99 * self._rated[:n_dc])
        limit[:, :n_dc] = np.where(out, 0.0, self._q_scale[:n_dc])
        return limit
