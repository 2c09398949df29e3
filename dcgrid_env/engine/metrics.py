"""Figures of an episode: what the tables, the records and the score are made of.

| metric | meaning |
|---|---|
| J | the cost of the episode, see ``reward``; also split into its terms, ``cost_*``, which add up to it |
| voltage_deviation_mean_pu, _std_pu | of abs(V - 1) over buses other than the substation and steps 1 .. T |
| outside_bus_seconds_pct | share of those bus-steps beyond the band |
| outside_buses_pct | share of buses ever beyond it |
| voltage_min_pu, voltage_max_pu | over the same |
| voltage_step_mean_pu | mean of abs(V_t - V_{t-1}), over one step of dt |
| delay_mean_s, _p50_s, _p95_s, _p99_s | waiting time of work, first come first served in each class, weighted by work |
| arrived_kws, unserved_kws | work that arrived, and that was still queued at the end |
| loss_mean_kw, loss_energy_kwh | loss of the feeder |
| q_effort_pct | mean abs(q) as a share of the apparent-power rating |
| clock_mean_pct | mean clock as a share of the top clock |
| steps, power_flow_converged | steps done; 0 if the power flow ended the episode |

Where the trace is made of requests, over those that arrived in the episode at any site, see ``request_delay`` (all are
0 if none did):

| metric | meaning |
|---|---|
| requests_sampled | how many the figures are over: of the sources of many requests a second, an even sample |
| requests_unfinished_pct | those of them with work still queued at the end |
| ttft_mean_s, _p50_s, _p95_s, _p99_s | time from arrival to the first token |
| e2e_mean_s, _p50_s, _p95_s, _p99_s | time from arrival to the last token |
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dcgrid_env.devices import speed_share
from dcgrid_env.engine.request_delay import RequestDelays, request_delays, serve_requests
from dcgrid_env.engine.trace_pool import trace_pool
from dcgrid_env.engine.waiting_time import fcfs_delays
from dcgrid_env.scenario.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.engine.simulation import Transition


class Series:
    """One episode as arrays over time: ``v_pu`` and ``backlog_kws`` from the reset on (T + 1 rows), the rest T rows."""

    def __init__(self, scenario: Scenario, transitions: list[Transition], lane: int):
        self.scenario = scenario
        states = [t.state for t in transitions]
        steps = transitions[1:]
        self.v_pu = np.array([s.v_pu[lane] for s in states])
        self.backlog_kws = np.array([s.backlog_kws[lane] for s in states])
        self.f_mhz = np.array([s.f_mhz[lane] for s in states[1:]])
        self.p_kw = np.array([s.p_kw[lane] for s in states[1:]])
        self.q_kvar = np.array([s.q_kvar[lane] for s in states[1:]])
        self.arrived_kw = np.array([s.arrived_kw[lane] for s in states[1:]])
        self.served_kw = np.array([s.served_kw[lane] for s in states[1:]])
        self.class_arrived_kw = np.array([s.class_arrived_kw[lane] for s in states[1:]])
        self.class_served_kw = np.array([s.class_served_kw[lane] for s in states[1:]])
        self.trace_start = transitions[0].trace_start[lane]
        self.loss_kw = np.array([t.loss_kw[lane] for t in steps])
        self.cost_j = np.array([t.cost_j[lane] for t in steps])
        self.costs = {name: np.array([getattr(t.costs, name)[lane] for t in steps]) for name in steps[0].costs._fields}
        self.converged = bool(steps[-1].converged[lane])

    def metrics(self) -> dict[str, float]:
        """The figures of the module's table."""
        s = self.scenario
        v = self.v_pu[1:, 1:]
        deviation = np.abs(v - 1.0)
        outside = deviation > s.band_pu
        arrived, served = (w.reshape(len(w), -1) for w in (self.class_arrived_kw, self.class_served_kw))
        delays = fcfs_delays(arrived, served, s.dt_s)
        requests = self._request_delays()
        ratings = np.concatenate((s.datacenter.s_rated_kva, s.inverter.s_rated_kva))
        clock = self.f_mhz.mean() / s.f_max_mhz if s.n_datacenters else 1.0
        found = {
            "J": self.cost_j.sum() / s.horizon,
            **{f"cost_{name}": values.sum() / s.horizon for name, values in self.costs.items()},
            "voltage_deviation_mean_pu": deviation.mean(),
            "voltage_deviation_std_pu": deviation.std(),
            "outside_bus_seconds_pct": 100.0 * outside.mean(),
            "outside_buses_pct": 100.0 * outside.any(axis=0).mean(),
            "voltage_min_pu": v.min(),
            "voltage_max_pu": v.max(),
            "voltage_step_mean_pu": np.abs(np.diff(self.v_pu[:, 1:], axis=0)).mean(),
            "delay_mean_s": delays.mean_s,
            "delay_p50_s": delays.p50_s,
            "delay_p95_s": delays.p95_s,
            "delay_p99_s": delays.p99_s,
            "arrived_kws": delays.arrived_kws,
            "unserved_kws": delays.unserved_kws,
            "loss_mean_kw": self.loss_kw.mean(),
            "loss_energy_kwh": self.loss_kw.sum() * s.dt_s / 3600.0,
            "q_effort_pct": 100.0 * (np.abs(self.q_kvar) / ratings).mean(),
            "clock_mean_pct": 100.0 * clock,
            "steps": len(v),
            "power_flow_converged": self.converged,
            **(requests._asdict() if requests else {}),
        }
        return {name: float(value) for name, value in found.items()}

    def _request_delays(self) -> RequestDelays | None:
        """Figures over the requests of all sites; None where the trace is not made of requests."""
        s = self.scenario
        pool = trace_pool(s)
        if not (pool.requests and s.n_datacenters):
            return None
        row, offset = np.divmod(self.trace_start, pool.p_share.shape[1])
        arrived, served = (w.reshape(*w.shape[:2], -1) for w in (self.class_arrived_kw, self.class_served_kw))
        speed = speed_share(s.dvfs, s.datacenter, self.f_mhz)
        begin_s = (offset + 1) * s.dt_s
        return request_delays(
            serve_requests(pool.requests[row[i]], begin_s[i], arrived[:, i], served[:, i], speed[:, i], s.dt_s)
            for i in range(s.n_datacenters)
        )


class Recorder:
    """Collects the transitions of one episode in every lane of a batch, from the reset on."""

    def __init__(self, scenario: Scenario, begun: Transition):
        self.scenario = scenario
        self._transitions = [begun]
        lanes = len(begun.terminated)
        self._length = np.zeros(lanes, dtype=np.int64)
        self._over = np.zeros(lanes, dtype=bool)

    def add(self, transition: Transition) -> None:
        """Take a step's transition; a lane whose episode has ended before is not counted further."""
        self._length += ~self._over
        self._over |= transition.terminated | transition.truncated
        self._transitions.append(transition)

    @property
    def over(self) -> bool:
        """Whether the episode has ended in every lane."""
        return bool(self._over.all())

    def lane(self, lane: int) -> Series:
        """The course of one lane's episode; ValueError before its first step."""
        if self._length[lane] == 0:
            raise ValueError("no step has been recorded yet")
        taken = self._transitions[: int(self._length[lane]) + 1]
        return Series(self.scenario, taken, lane)

    def costs(self) -> np.ndarray:
        """J of each lane's episode, (lane,); ValueError before all have ended."""
        if not self.over:
            raise ValueError("costs of an episode that has not ended; step until every lane is over")
        charged = np.array([t.cost_j for t in self._transitions[1:]])
        within = np.arange(len(charged))[:, None] < self._length
        return (charged * within).sum(axis=0) / self.scenario.horizon

    def metrics(self) -> list[dict[str, float]]:
        """The figures of each lane's episode; ValueError before all have ended."""
        if not self.over:
            raise ValueError("metrics of an episode that has not ended; step until every lane is over")
        return [self.lane(i).metrics() for i in range(len(self._over))]
