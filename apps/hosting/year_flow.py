"""Power flows over all samples of a scenario's load profiles, such as a year in steps of 15 min, and the worst hours.

The days are the environments of one batch: all days advance together from one sample to the next. Regulators follow
their control within a day, and have settled at its begin; the state of a day does not pass to the next. Data centres
draw their full rating all the time, so voltages, loadings and losses are those of a load that never pauses. The loads
have no noise.

A second step of an analysis then simulates the worst hours in steps of a second, see :func:`hour_scenario`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.apps.hosting.element_names import branch_to, time_text
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.baselines.rollout import as_driven, transitions
from dcgrid_env.traces import WHOLE, PowerTrace

_VALUES = 2_000_000
"""Largest number of voltages of a batch; more days run in several batches."""
_ROUNDING = 1e-9
HOUR_STEPS = 3600
"""Steps of a second in a simulated hour."""


@dataclass(frozen=True)
class YearFlow:
    """Results of the power flows over a scenario's load profiles; arrays over samples, NaN without a result.

    A power flow without a solution ends its day: the samples after it have no result.
    """

    scenario: Scenario
    hours: np.ndarray
    """Time of each sample, h since the midnight before the first one, (sample,)."""
    v_min_pu: np.ndarray
    """Lowest voltage of the nodes other than the substation's, p.u., (sample,)."""
    v_max_pu: np.ndarray
    """Highest voltage, p.u., (sample,)."""
    loading: np.ndarray
    """Highest current as a share of the rating, (sample,); 0 without known ratings."""
    loss_kw: np.ndarray
    """Loss of the feeder, kW, (sample,)."""
    lowest: np.ndarray
    """Position in ``node_ids`` of the lowest voltage, (sample,)."""
    highest: np.ndarray
    """Position in ``node_ids`` of the highest voltage, (sample,)."""
    loaded: np.ndarray
    """Position in ``State.loading`` of the highest loading, (sample,)."""
    solved: np.ndarray
    """Whether the power flow has a solution, bool, (sample,)."""

    @property
    def step_h(self) -> float:
        """Time between two samples, h."""
        return self.scenario.load_profiles.table.step_s / 3600.0

    @property
    def loss_mwh(self) -> float:
        """Energy lost over the solved samples, MWh."""
        return float(np.nansum(self.loss_kw)) * self.step_h / 1000.0

    def hours_outside(self, v_min_pu: float, v_max_pu: float, loading_max: float) -> dict[str, float]:
        """Return the hours below and above the voltage limits, above the loading limit, and without a solution."""
        counts = {
            "below the lowest voltage": self.v_min_pu < v_min_pu - _ROUNDING,
            "above the highest voltage": self.v_max_pu > v_max_pu + _ROUNDING,
            "above the rating": self.loading > loading_max + _ROUNDING,
            "without a solution, or after one in the day": ~self.solved,
        }
        return {name: float(np.sum(values)) * self.step_h for name, values in counts.items()}

    def worst(self) -> dict[str, int]:
        """Return the sample of the lowest and highest voltage, highest loading and highest loss, by quantity."""
        if not self.solved.any():
            return {}
        samples = {
            "lowest voltage": int(np.nanargmin(self.v_min_pu)),
            "highest voltage": int(np.nanargmax(self.v_max_pu)),
        }
        if np.nanmax(self.loading) > 0.0:
            samples["highest loading"] = int(np.nanargmax(self.loading))
        return samples | {"highest loss": int(np.nanargmax(self.loss_kw))}

    def value(self, quantity: str, sample: int) -> str:
        """Return the value of a quantity of :meth:`worst` at a sample, with its location, as text."""
        feeder = self.scenario.feeder
        if quantity == "lowest voltage":
            return f"{self.v_min_pu[sample]:.4f} p.u. at {feeder.node_ids[self.lowest[sample]]}"
        if quantity == "highest voltage":
            return f"{self.v_max_pu[sample]:.4f} p.u. at {feeder.node_ids[self.highest[sample]]}"
        if quantity == "highest loading":
            return f"{100.0 * self.loading[sample]:.1f} % at {branch_to(feeder, int(self.loaded[sample]))}"
        return f"{self.loss_kw[sample]:.5g} kW"

    def time_text(self, sample: int) -> str:
        """Return the date, or the number of the day from 1, and the time of day of a sample."""
        return time_text(self.scenario, float(self.hours[sample]))


def year_flow(scenario: Scenario, on_step: Callable[[int, int], None] | None = None) -> YearFlow:
    """Solve the power flow at each sample of a scenario's load profiles, without control.

    Parameters
    ----------
    scenario
        A scenario with load profiles and given buses.
    on_step
        Function called with the number of power flows that are done, and of all.

    Raises
    ------
    ValueError
        If the scenario has no load profiles, or draws the buses of its data centres; the message has the remedy.
    """
    table = scenario.load_profiles.table
    if any(device.buses is None and device.count for device in scenario.devices):
        raise ValueError(
            f"scenario {scenario.name!r} draws the buses of its devices in each episode; give them with "
            "datacenters.buses"
        )
    n = len(table.values)
    per_day = min(round(86400.0 / table.step_s), n)
    begins = list(range(0, n - per_day + 1, per_day))
    if begins[-1] + per_day < n:
        begins.append(n - per_day)  # the rest of the file, with a part of the day before it again
    daily = as_driven(_daily_scenario(scenario, per_day), NoControl())
    out = {name: np.full(n, np.nan) for name in ("v_min_pu", "v_max_pu", "loading", "loss_kw")}
    where = {name: np.zeros(n, np.int64) for name in ("lowest", "highest", "loaded")}
    solved, done = np.zeros(n, bool), 0
    at_once = max(1, _VALUES // (scenario.feeder.n_node * 16))
    hours = table.begin_h + table.step_s / 3600.0 * np.arange(n)
    for first in range(0, len(begins), at_once):
        days = np.array(begins[first : first + at_once])
        goes_on = np.ones(len(days), bool)
        steps = transitions(daily, NoControl(), [0] * len(days), None, {"begin_h": hours[days]})
        for k in range(per_day):
            now = next(steps)
            goes_on &= np.asarray(now.converged)
            _note(daily, now, (days + k)[goes_on], goes_on, out, where)
            solved[(days + k)[goes_on]] = True
            done += len(days)
            if on_step is not None:
                on_step(done, len(begins) * per_day)
        steps.close()
    return YearFlow(scenario, hours, **out, **where, solved=solved)


def _note(
    scenario: Scenario, now: Any, samples: np.ndarray, rows: np.ndarray, out: dict[str, Any], where: dict[str, Any]
) -> None:
    """Note the voltages, loadings and losses of some rows at their samples."""
    nodes = scenario.feeder.load_slice
    v, row = now.state.v_pu[rows][:, nodes], np.arange(len(samples))
    lowest, highest, first = v.argmin(axis=1), v.argmax(axis=1), nodes.start or 0
    out["v_min_pu"][samples], out["v_max_pu"][samples] = v[row, lowest], v[row, highest]
    where["lowest"][samples], where["highest"][samples] = lowest + first, highest + first
    out["loss_kw"][samples] = now.loss_kw[rows]
    out["loading"][samples] = 0.0
    if now.state.loading is not None:
        loading = now.state.loading[rows]
        where["loaded"][samples] = loading.argmax(axis=1)
        out["loading"][samples] = loading.max(axis=1)


def _daily_scenario(scenario: Scenario, per_day: int) -> Scenario:
    """Return the scenario whose episodes are days in steps of the profiles, with sites at their rating."""
    step_s = scenario.load_profiles.table.step_s
    full = PowerTrace([0.0, 10.0 * step_s * (per_day + 2)], [1.0, 1.0], "full rating", compute_kw=[1.0, 1.0])
    return scenario.replace(
        trace=(full,),
        workload={"site_correlation": 0.0, "trace_scale": "rated", "full_load_s": None, "recording_split": "time"},
        background={"load_sigma": 0.0, "start_hour": None},
        load_profiles={"days": "all", "start_h": None},
        dt_s=step_s,
        horizon=max(1, per_day - 1),
        split=WHOLE,
    )


def hour_scenario(scenario: Scenario, flow: YearFlow, sample: int) -> Scenario:
    """Return the scenario with one hour in steps of a second that contains a sample of a year's power flows.

    The data centres follow their trace, and draw their full rating in the middle third of the hour.
    """
    table = scenario.load_profiles.table
    begin_h = min(float(np.floor(flow.hours[sample] + _ROUNDING)), table.begin_h + table.duration_h - 1.0)
    steps = min(HOUR_STEPS, int(3600.0 * table.duration_h + 1e-9))  # of a file that covers less
    third = steps / 3.0
    return scenario.replace(
        dt_s=1.0,
        horizon=steps,
        background={"start_hour": None},
        load_profiles={"days": "all", "start_h": max(begin_h, table.begin_h)},
        workload={"full_load_s": (third, 2.0 * third)},
    )
