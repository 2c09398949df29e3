"""The sections of a connection study, each computed from the request and the capacity study."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dcgrid_env import Feeder, Scenario, metrics_in, rating_coverage
from dcgrid_env.baselines.benchmark.benchmark_tables import Table
from dcgrid_env.baselines.connection_study.section import Section, figure_of
from dcgrid_env.baselines.connection_study.study_request import StudyRequest
from dcgrid_env.baselines.hosting_capacity.added_site import AddedSite
from dcgrid_env.baselines.hosting_capacity.capacity_study import Study
from dcgrid_env.baselines.hosting_capacity.hosting import (
    UNCONTROLLED,
    snapshot_capacity,
    study_controller,
)
from dcgrid_env.baselines.hosting_capacity.site_scenario import with_sites
from dcgrid_env.baselines.hosting_capacity.trial import branch_to, run_trial
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.baselines.rollout import rollout, transitions
from dcgrid_env.core.html_page import png
from dcgrid_env.rendering import draw_feeder, positions, run_figure

DAY_DT_S, DAY_STEPS = 60.0, 1440
FLICKER_DT_S, FLICKER_STEPS = 0.1, 6000
RIDE_THROUGH_S = 300.0


@dataclass(frozen=True)
class Job:
    """A request and the study that answers it."""

    request: StudyRequest
    study: Study

    @property
    def sized(self) -> int:
        """The requested rating in steps of the study, rounded up."""
        return int(np.ceil(self.request.mw / self.study.step_mw - 1e-9))

    def scenario(self, mw: float, **changes: Any) -> Scenario:
        """The study's scenario with a site of a rating at the requested bus, 0 MW for none, and other changes."""
        return with_sites(self.study, (self.request.bus,), (mw,), **changes)

    def controllers(self) -> list[tuple[str, Any]]:
        """The controllers of the request by name."""
        return [(name, study_controller(name, self.study.scenario, None)[0]) for name in self.request.controllers]


def base_case(job: Job) -> Section:
    """The feeder at nominal load without the site: voltages, loadings, losses, taps."""
    study, feeder = job.study, job.study.scenario.feeder
    scenario = job.scenario(0.0, horizon=1, background={"load_sigma": 0.0, "start_hour": None})
    steps = transitions(scenario, NoControl(), [0])
    start = next(steps)
    steps.close()
    v, loading = start.state.v_pu[0], start.state.loading
    judged = np.arange(feeder.n_node)[feeder.load_slice]
    lowest, highest = judged[v[judged].argmin()], judged[v[judged].argmax()]
    rows = [
        ("lowest voltage", f"{v[lowest]:.4f} p.u.", feeder.node_ids[lowest]),
        ("highest voltage", f"{v[highest]:.4f} p.u.", feeder.node_ids[highest]),
        ("source voltage", f"{scenario.source_voltage_pu:.4f} p.u.", feeder.bus_ids[0]),
        ("load", f"{feeder.p_load_kw.sum():.6g} kW, {feeder.q_load_kvar.sum():.6g} kvar", ""),
        ("losses", f"{start.loss_kw[0]:.5g} kW", ""),
    ]
    if loading is not None and np.any(loading[0] > 0.0):
        most = int(loading[0].argmax())
        rows.append(("highest loading", f"{100.0 * loading[0, most]:.1f} % of the rating", branch_to(feeder, most)))
    coverage = rating_coverage(feeder)
    rows.append(("ratings", f"known for {coverage.known} of {coverage.of} elements", ""))
    tables = [Table("Base case", ("quantity", "value", "where"), tuple(rows))]
    if not isinstance(feeder, Feeder) and feeder.n_regulator:
        taps = start.state.three_phase.equipment.regulators.tap[0]
        names = feeder.network.regulator.name
        rows = tuple((name, f"{tap:g}") for name, tap in zip(names, taps, strict=True))
        tables.append(Table("Taps of the regulators", ("regulator", "tap"), rows))
    by_bus = np.array([v[feeder.node_bus == i].mean() for i in range(feeder.n_bus)])
    figure = Figure(figsize=(9.0, 6.0))
    FigureCanvasAgg(figure)
    ax = figure.add_axes((0.01, 0.02, 0.86, 0.92))
    site = [feeder.index(job.request.bus)]
    drawn = draw_feeder(ax, feeder, positions(feeder), by_bus, site, band_pu=_half_band(study))
    figure.colorbar(drawn.dots, cax=figure.add_axes((0.9, 0.15, 0.02, 0.7)), label="voltage (p.u.)")
    picture = ("The feeder in the base case: colour is voltage, the large circle is the requested bus", png(figure))
    text = "Loads are at their nominal values, without noise. Nothing is controlled except regulators."
    return Section("base-case", "Base case", (text,), tuple(tables), (picture,))


def worst_window(job: Job) -> Section:
    """The window in which the requested size comes nearest to a limit, under each controller."""
    study, bus = job.study, job.request.bus
    worst, margin = _worst_window(job)
    at_hour = float(study.hours[worst]) if study.load == "day" else None
    scenario = job.scenario(job.request.mw, **study.window_fields | {"background.start_hour": at_hour})
    series = {}
    for name, controller in job.controllers():
        series[name] = rollout(scenario, controller, [worst], name=name).series(0)
    hour = "nominal load" if study.load == "peak" else f"{study.hours[worst]:.1f} h"
    text = (
        f"Of {study.samples} windows, number {worst} ({hour}) comes nearest to a limit with {job.request.mw:g} MW at "
        f"bus {bus} and without control. Its margin is {margin:.3f}: a share of half the width of the voltage limits, "
        f"or of another limit, and negative beyond it. The site is at its full rating from {study.full_load_s[0]:g} to "
        f"{study.full_load_s[1]:g} s."
    )
    figure = run_figure(scenario, series, worst)
    return Section(
        "worst-window", "Worst window", (text,), (_metrics(series, "Metrics of the worst window"),),
        (("Voltages, power and set points in the worst window", png(figure)),),
    )  # fmt: skip


def day(job: Job) -> Section:
    """A day with and without the site at its full rating: voltages, losses, taps."""
    study = job.study
    changes: dict[str, Any] = {
        "dt_s": DAY_DT_S, "horizon": DAY_STEPS, "background.start_hour": 0.0,
        "workload.full_load_s": (0.0, DAY_DT_S * DAY_STEPS),
    }  # fmt: skip
    series = {}
    for name, mw in (("without the site", 0.0), (f"with {job.request.mw:g} MW", job.request.mw)):
        series[name] = rollout(job.scenario(mw, **changes), NoControl(), [0]).series(0)
    text = (
        "One day in steps of a minute. The other loads follow the hour of the day, and the site draws its full rating "
        "all day, without control: sites rarely do, so losses and taps are upper values."
    )
    return Section(
        "day", "A day at the full rating", (text,), (_metrics(series, "Metrics of the day"),),
        (("Lowest and highest voltage over the day", png(_day_figure(study, series))),),
    )  # fmt: skip


def ride_through(job: Job) -> Section:
    """Recorded sags, by which the site leaves the grid and comes back."""
    study, asked = job.study, job.request.ride_through
    scenario = job.scenario(
        job.request.mw, horizon=round(RIDE_THROUGH_S / study.scenario.dt_s), sags=asked.sags,
        **{"datacenters.ride_through": {"curve": asked.curve}, "background.start_hour": None},
    )  # fmt: skip
    series = {name: rollout(scenario, controller, [0], name=name).series(0) for name, controller in job.controllers()}
    text = (
        f"The site follows the curve {asked.curve} during the sags {asked.sags}. It leaves the grid when the curve's "
        "time is over, continues on battery and comes back by the rule of docs/ride-through.md. No controller can "
        "prevent a sag; it changes the voltages after the loss and the return."
    )
    return Section("ride-through", "Ride-through and return", (text,), (_metrics(series, "Metrics of the sags"),))


def fluctuation(job: Job) -> Section:
    """Ramps, voltage steps and flicker in ten minutes of the trace, against the request's limits."""
    limits = job.request.limits
    cost = {"ramp_window_s": limits.ramp_window_s, "voltage_step_limit_pu": limits.voltage_step_pct / 100.0}
    ramp = limits.ramp_kw_per_s
    cost["ramp_limit_kw_per_s"] = 1000.0 * job.request.mw if ramp is None else ramp
    scenario = job.scenario(
        job.request.mw, dt_s=FLICKER_DT_S, horizon=FLICKER_STEPS, cost=cost,
        **{"background.start_hour": None},
    )  # fmt: skip
    rows = []
    for name, controller in job.controllers():
        m = rollout(scenario, controller, [0], name=name).metrics()[0]
        rows.append((name, figure_of(m["ramp_max_kw_per_s"]), figure_of(m["voltage_step_max_pu"] * 100.0),
                     figure_of(m["pst_max"])))  # fmt: skip
    allowed = ("limit", "none stated" if ramp is None else figure_of(ramp), figure_of(limits.voltage_step_pct),
               figure_of(limits.pst))  # fmt: skip
    header = ("controller", f"largest ramp over {limits.ramp_window_s:g} s, kW/s",
              f"largest voltage change in {FLICKER_DT_S:g} s, %", "largest short-term flicker Pst")  # fmt: skip
    text = (
        f"Ten minutes of the trace in steps of {FLICKER_DT_S:g} s. Limits come from: {limits.source}. Pst is that of "
        "IEC 61000-4-15 for a lamp of 120 V and 60 Hz, without fluctuations above 5 Hz."
    )
    return Section("fluctuation", "Ramps and flicker", (text,), (Table("Fluctuation", header, (*rows, allowed)),))


def sensitivity(job: Job) -> Section:
    """How the snapshot's capacity at the bus changes with the assumptions."""
    study = dataclasses.replace(job.study, tolerance_mw=job.study.step_mw, max_mw=job.study.largest_mw)
    base = study.scenario
    cases: list[tuple[str, Study]] = [("as assumed", study)]
    for percent in (-1.0, 1.0):
        source = base.source_voltage_pu * (1.0 + percent / 100.0)
        changed = dataclasses.replace(study, scenario=base.replace(source_voltage_pu=source))
        cases.append((f"source voltage {percent:+g} %", changed))
    for change in (-0.01, 0.01):
        changed = dataclasses.replace(study, v_min_pu=study.v_min_pu + change)
        cases.append((f"lowest allowed voltage {study.v_min_pu + change:g} p.u.", changed))
    for percent in (90.0, 110.0):
        changed = dataclasses.replace(study, loading_max_pct=percent)
        cases.append((f"loading up to {percent:g} % of the ratings", changed))
    bus = np.array([base.feeder.index(job.request.bus)])
    rows = []
    for name, changed in cases:
        (found,) = snapshot_capacity(changed, bus)
        rows.append((name, f"{'>=' if found.at_most else ''}{found.capacity_mw:g}", found.limit or "none found"))
    text = f"Capacity of bus {job.request.bus} in one power flow at peak load, one assumption changed at a time."
    return Section(
        "sensitivity", "Sensitivity to assumptions", (text,),
        (Table("Snapshot capacity", ("assumption", "MW", "limit"), tuple(rows)),),
    )  # fmt: skip


BUILDERS: dict[str, Callable[[Job], Section]] = {
    "base-case": base_case,
    "worst-window": worst_window,
    "day": day,
    "ride-through": ride_through,
    "fluctuation": fluctuation,
    "sensitivity": sensitivity,
}
"""Sections that need the request and the study alone."""


def _half_band(study: Study) -> float:
    return max(study.v_max_pu - 1.0, 1.0 - study.v_min_pu)


def _worst_window(job: Job) -> tuple[int, float]:
    """Number and margin of the window that comes nearest to a limit with the requested size without control."""
    study, samples = job.study, np.arange(job.study.samples)
    bus = np.full(len(samples), study.scenario.feeder.index(job.request.bus))
    trial = run_trial(AddedSite(study), NoControl(), job.sized, bus, samples, UNCONTROLLED)
    margins = trial.margins.min(axis=1)
    worst = int(margins.argmin())
    return worst, float(margins[worst])


def _metrics(series: dict[str, Any], title: str) -> Table:
    """The metrics of some runs, a column for each."""
    figures = {name: run.metrics() for name, run in series.items()}
    first = next(iter(figures.values()))
    rows = [
        (metric.label, metric.unit, *(metric.text(metric.of_episodes([of[metric.name]])) for of in figures.values()))
        for metric in metrics_in("run")
        if metric.name in first and metric.name != "J"
    ]
    return Table(title, ("metric", "unit", *figures), tuple(rows))


def _day_figure(study: Study, series: dict[str, Any]) -> Figure:
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    for (name, run), colour in zip(series.items(), ("#0072B2", "#D55E00"), strict=True):
        v = run.v_pu[:, study.scenario.feeder.load_slice]
        hours = np.arange(len(v)) * DAY_DT_S / 3600.0
        ax.plot(hours, v.min(axis=1), color=colour, linewidth=1.0, label=name)
        ax.plot(hours, v.max(axis=1), color=colour, linewidth=1.0)
    for limit in (study.v_min_pu, study.v_max_pu):
        ax.axhline(limit, color="#444444", linewidth=0.8, linestyle="--")
    ax.set_xlabel("hour of the day")
    ax.set_ylabel("lowest and highest voltage (p.u.)")
    ax.set_xlim(0.0, 24.0)
    ax.grid(alpha=0.25)
    ax.legend(frameon=False)
    return figure
