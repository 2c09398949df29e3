"""Figures of an episode: what the tables, the records and the score are made of.

| metric | meaning |
|---|---|
| J | the cost of the episode, see ``reward``; also split into its terms, ``cost_*``, which add up to it |
| voltage_deviation_mean_pu, _std_pu | of abs(V - 1) over nodes but the substation's and steps 1 .. T (b) |
| outside_bus_seconds_pct | share of those nodes and steps beyond the band |
| outside_buses_pct | share of nodes ever beyond it |
| voltage_min_pu, voltage_max_pu | over the same |
| voltage_step_mean_pu | mean of abs(V_t - V_{t-1}), over one step of dt |
| delay_mean_s, _p50_s, _p95_s, _p99_s | waiting time of work, first come first served in each class, weighted by work |
| arrived_kws, unserved_kws | work that arrived, and that was still queued at the end |
| loss_mean_kw, loss_energy_kwh | loss of the feeder: branches, and cores of three-phase transformers |
| q_effort_pct | mean abs(q) as a share of the apparent-power rating |
| clock_mean_pct | mean clock as a share of the top clock |
| unbalance_mean_pct, unbalance_max_pct | voltage unbalance factor of three-phase buses over the steps 1 .. T |
| nema_unbalance_max_pct | unbalance by NEMA MG 1 over the same |
| tap_moves, capacitor_switchings | taps of all regulators in either direction, and switchings of all banks, the same |
| steps, power_flow_converged | steps done; 0 if the power flow ended the episode |
| loading_max_pct | highest current of a branch as a share of its rating; where the feeder knows ratings |
| overloaded_branch_seconds_pct | share of rated branches (of a line's phases) and steps above it, the same |
| pst_max, swing_*, ramp_*, voltage_step_max_pu, voltage_step_excess_pct | see ``fluctuation``; where they can be had |

(b) A balanced feeder has one node a bus; on a three-phase feeder a node is a phase of a bus.

Where there are storages, over all of them, see ``devices.storage``:

| metric | meaning |
|---|---|
| stored_end_pct, stored_lowest_pct | stored energy at the end and at its lowest, as a share of what they can store |
| storage_throughput_kwh | energy charged and energy discharged, at the grid, over the steps 1 .. T |
| storage_loss_kwh | energy drawn that is neither given back nor stored at the end, the same |
| storage_missing_kwh | what is missing at the end of the energy that is to be returned |
| site_* | the same five over the storages behind data centres' converters |

Where devices may leave the grid (docs/ride-through.md), over all sites, or inverters, and the steps 1 .. T:

| metric | meaning |
|---|---|
| ups_trips, inverter_trips | how often one left the grid |
| ups_lost_kw, ups_lost_step_kw | draw of the sites that left, in all and the most in a step |
| ups_away_s, inverter_away_s | site-seconds, or inverter-seconds, away, a ramp by its share |
| ups_locked_s | site-seconds locked out |
| ups_all_back_s | from the first step with a site away to the last |
| battery_work_kws, battery_energy_kws | work served on battery, and energy drawn from batteries |
| battery_missing_kws | what is missing in the batteries at the end |
| voltage_after_loss_max_pu | highest voltage of the feeder in steps with a device away; 0 if there is none |

Where work is moved, batched or served by a time (docs/routing.md), over all sites and the steps 1 .. T:

| metric | meaning |
|---|---|
| moved_kws, moved_pct | work that was served at another site than it arrived at, and its share of all |
| batch_mean | mean setpoint of the batch size |
| in_time_pct, interactive_in_time_pct, deferrable_in_time_pct | share of work served within its target or deadline |
| lateness_mean_s, lateness_p95_s | how late work was, 0 where in time, weighted by work |

Where the trace is made of requests, over those that arrived in the episode at any site (all are 0 if none did), see
``devices.datacenter.request_delay``:

| metric | meaning |
|---|---|
| requests_sampled | how many the figures are over: of the sources of many requests a second, an even sample |
| requests_unfinished_pct | those of them with work still queued at the end |
| ttft_mean_s, _p50_s, _p95_s, _p99_s | time from arrival to the first token |
| e2e_mean_s, _p50_s, _p95_s, _p99_s | time from arrival to the last token |
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dcgrid_env.devices.grid_equipment import is_equipment
from dcgrid_env.engine.fluctuation import WorstFlicker, fluctuation, worst_flicker
from dcgrid_env.engine.leaving import after_loss
from dcgrid_env.engine.state import field_of_devices, over_arrays
from dcgrid_env.engine.trace_pool import trace_pool
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.powerflow import nema_unbalance
from dcgrid_env.scenario.costs.overload import overload_figures
from dcgrid_env.scenario.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.engine.simulation import Transition


class Series:
    """One episode as arrays over time: ``v_pu`` and ``backlog_kws`` from the reset on (T + 1 rows), the rest T rows."""

    def __init__(self, scenario: Scenario, transitions: list[Transition], lane: int):
        self._take(scenario, _course(transitions, lambda values: np.array([own[lane] for own in values])), lane)

    @classmethod
    def of_lanes(cls, scenario: Scenario, transitions: list[Transition], lengths: Sequence[int]) -> list[Series | None]:
        """The first so many steps of each lane; None where there are none. Lanes share memory."""
        stacked = _course(transitions, np.array)
        return [cls._cut(scenario, stacked, lane, n) if n else None for lane, n in enumerate(lengths)]

    @classmethod
    def _cut(cls, scenario: Scenario, stacked: _Course, lane: int, steps: int) -> Series:
        series = cls.__new__(cls)
        from_reset = over_arrays(lambda values: values[: steps + 1, lane], stacked.from_reset)
        of_steps = over_arrays(lambda values: values[:steps, lane], stacked.of_steps)
        series._take(scenario, _Course(from_reset, of_steps, stacked.drawn), lane)
        return series

    def _take(self, scenario: Scenario, course: _Course, lane: int) -> None:
        self.scenario = scenario
        self.v_pu, self.p_kw_from_reset, self.devices, self.three_phase, self.loading = course.from_reset
        """``devices`` are the states of each device over time, and ``three_phase`` is ``State.three_phase``, None on a
        balanced feeder, from the reset on; so is ``loading``, ``State.loading``, None where no rating is known."""
        self.p_kw = self.p_kw_from_reset[1:]
        self.q_kvar, self.loss_kw, self.cost_j, converged, costs = course.of_steps
        self.costs = costs._asdict()
        self.trace_start, self.buses, self.fault = (own[lane] for own in course.drawn)
        """Where each site's trace window begins, (n_site,); position in ``bus_ids`` of each agent's bus, (n_agent,);
        what each fault strikes and when, ``Episode.fault``, (n_fault, 3)."""
        self.converged = bool(converged[-1])

    def __getattr__(self, name: str) -> np.ndarray:
        """A field of a device's state over time, (T, slot), from the reset on where it is an amount at an instant."""
        if name.startswith("_") or name in ("devices", "scenario"):  # asked for before there are any, by copy say
            raise AttributeError(name)
        over_time = field_of_devices(self.devices, name)
        return over_time if any(name in device.levels for device in self.scenario.devices) else over_time[1:]

    def metrics(self) -> dict[str, float]:
        """The figures of the module's table."""
        s = self.scenario
        figures = self.grid_figures() | fluctuation(s, self.v_pu, self.p_kw_from_reset) | self.phase_figures()
        for device, history in zip(s.devices, self.devices, strict=True):
            requests = self.requests() if device.input == "workload" else None
            figures |= device.metrics(history, s.dt_s, requests)
        return {name: float(value) for name, value in figures.items()} | self.after_loss()

    def after_loss(self) -> dict[str, float]:
        """Highest voltage with devices away, where they can leave."""
        figures = after_loss(self.scenario, self.devices, self.v_pu[1:, self.scenario.feeder.load_slice])
        return {name: float(value) for name, value in figures.items()}

    def grid_figures(self) -> dict[str, Any]:
        """Those of the table that costs, voltages and losses have."""
        s = self.scenario
        v = self.v_pu[1:, s.feeder.load_slice]
        deviation = np.abs(v - 1.0)
        outside = deviation > s.band_pu
        converters = [device for device in s.devices if not is_equipment(device)]  # which stand first
        ratings = np.concatenate([device.converter_kva for device in converters])
        return {
            "J": self.cost_j.sum() / s.horizon,
            **{f"cost_{name}": values.sum() / s.horizon for name, values in self.costs.items()},
            "voltage_deviation_mean_pu": deviation.mean(),
            "voltage_deviation_std_pu": deviation.std(),
            "outside_bus_seconds_pct": 100.0 * outside.mean(),
            "outside_buses_pct": 100.0 * outside.any(axis=0).mean(),
            "voltage_min_pu": v.min(),
            "voltage_max_pu": v.max(),
            "voltage_step_mean_pu": np.abs(np.diff(self.v_pu[:, s.feeder.load_slice], axis=0)).mean(),
            "loss_mean_kw": self.loss_kw.mean(),
            "loss_energy_kwh": self.loss_kw.sum() * s.dt_s / 3600.0,
            "q_effort_pct": 100.0 * (np.abs(self.q_kvar[:, : len(ratings)]) / ratings).mean() if len(ratings) else 0.0,
            "steps": len(v),
            "power_flow_converged": self.converged,
            **overload_figures(s, self.loading),
        }

    def phase_figures(self) -> dict[str, Any]:
        """Those that a three-phase feeder has beside."""
        feeder = self.scenario.feeder
        return self._unbalance(feeder) | self._moves() if isinstance(feeder, ThreePhaseFeeder) else {}

    def worst_flicker(self, lamp: str = "120V-60Hz") -> WorstFlicker:
        """Largest Pst of the episode, and where and when it was, in the light of a lamp of ``flicker.LAMPS``.

        ValueError for steps of more than 0.1 s, or a scenario whose episodes are shorter than 600 s.
        """
        return worst_flicker(self.scenario, self.v_pu[1:], lamp)

    def _unbalance(self, feeder: ThreePhaseFeeder) -> dict[str, float]:
        """Figures of the unbalance of a three-phase feeder's voltages."""
        phases: Any = self.three_phase
        factor = phases.unbalance[1:]
        nema = nema_unbalance(feeder, phases.v_re_pu[1:], phases.v_im_pu[1:])
        return {
            "unbalance_mean_pct": 100.0 * factor.mean() if factor.size else 0.0,
            "unbalance_max_pct": 100.0 * factor.max(initial=0.0),
            "nema_unbalance_max_pct": 100.0 * nema.max(initial=0.0),
        }

    def _moves(self) -> dict[str, float]:
        """Figures of the equipment of a three-phase feeder."""
        regulators, banks = self.three_phase.equipment
        return {"tap_moves": regulators.moved[1:].sum(), "capacitor_switchings": banks.switched[1:].sum()}

    def requests(self) -> list[tuple[Any, float]] | None:
        """The requests of each site's row of trace and when the episode begins among them, s; None without any.

        Also None if a period of full load asks for work without requests.
        """
        pool = trace_pool(self.scenario)
        if not (pool.requests and len(self.trace_start)) or self.scenario.full_load_s is not None:
            return None
        row, offset = np.divmod(self.trace_start, pool.p_share.shape[1])
        begin_s = (offset + 1) * self.scenario.dt_s
        return [(pool.requests[r], begin) for r, begin in zip(row, begin_s, strict=True)]


class _Course(NamedTuple):
    """What a series is made of, arrays with time in front."""

    from_reset: tuple[Any, ...]
    """Voltages, draws, states of the devices and of three phases, loading, from the reset on."""
    of_steps: tuple[Any, ...]
    """Reactive injections, losses, costs, whether the power flow had a solution, and the terms of the cost."""
    drawn: tuple[np.ndarray, ...]
    """Beginnings of the trace windows, buses of the agents, and faults, as a transition has them."""


def _course(transitions: list[Transition], stack: Callable[[Sequence[Any]], Any]) -> _Course:
    """Transitions as arrays; ``stack`` makes one of those of all instants."""

    def over_time(parts: list[Any]) -> Any:
        return over_arrays(lambda *values: stack(values), *parts)

    states = [t.state for t in transitions]
    from_reset = [(s.v_pu, s.p_kw, s.devices, s.three_phase, s.loading) for s in states]
    of_steps = [(t.state.q_kvar, t.loss_kw, t.cost_j, t.converged, t.costs) for t in transitions[1:]]
    begun = transitions[0]
    return _Course(over_time(from_reset), over_time(of_steps), (begun.trace_start, begun.buses, begun.fault))


class Recorder:
    """Collects the transitions of one episode in every lane of a batch, from the reset on.

    Parameters
    ----------
    scenario, begun
        What is run, and what the reset led to.
    seeds
        The seed of each lane's episode, its first, where feeders are random: its course is then said to be on one.
    """

    def __init__(self, scenario: Scenario, begun: Transition, seeds: Sequence[int] | None = None):
        self.scenario, self._seeds = scenario, seeds
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
        on = self.scenario if self._seeds is None else self.scenario.member(self._seeds[lane])
        return Series(on, taken, lane)

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
