"""The sections of a connection study, each computed from the request and the capacity study."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dcgrid_env import Feeder, LoadProfiles, Scenario, UpsRideThrough, acting_relays, metrics_in, recording_lines
from dcgrid_env.apps.hosting.added_site import AddedSite
from dcgrid_env.apps.hosting.capacity_study import Study
from dcgrid_env.apps.hosting.connection_study.limit_distances import limits_table, nearest, time_of
from dcgrid_env.apps.hosting.connection_study.section import Section, figure_of, rise_or_fall, sentences, under
from dcgrid_env.apps.hosting.connection_study.several_sites import several_sites
from dcgrid_env.apps.hosting.connection_study.study_job import Job
from dcgrid_env.apps.hosting.connection_study.study_request import NOT_STATED
from dcgrid_env.apps.hosting.connection_study.year_section import year
from dcgrid_env.apps.hosting.element_names import branch_to, time_text
from dcgrid_env.apps.hosting.load_hours import Windows, load_hours, windows_text, with_same_hours
from dcgrid_env.apps.hosting.trial import overloaded_nodes, run_trial
from dcgrid_env.apps.hosting.worst_hours import snapshot_capacity, study_windows
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.baselines.rollout import rollout, transitions
from dcgrid_env.core.figure_axes import new_figure
from dcgrid_env.core.html_page import png
from dcgrid_env.core.text_table import Table
from dcgrid_env.rendering import draw_feeder, positions, run_figure

DAY_H, DAY_DT_S, DAY_STEPS = 24.0, 60.0, 1440
FLICKER_DT_S, FLICKER_STEPS = 0.1, 6000
RIDE_THROUGH_S = 300.0
NOMINAL: dict[str, Any] = {"background.start_hour": None, "load_profiles": LoadProfiles()}
"""Fields of a scenario of at most an hour at nominal load, whatever the day or the load profiles."""


def base_case(job: Job) -> Section:
    """The feeder at nominal load without the site: voltages, loadings, losses, taps."""
    study, feeder = job.study, job.study.scenario.feeder
    scenario = job.scenario(0.0, horizon=1, **NOMINAL, **{"background.load_sigma": 0.0})
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
        side = "above" if 100.0 * loading[0, most] > study.loading_max_pct else "within"
        known = "known " * bool(study.coverage.not_checked)
        loaded = f", and the highest {known}loading is {rows[-1][1]} ({rows[-1][2]}), {side} its limit"
    else:
        loaded = ", and no rating is known"
    coverage = study.coverage
    basis = f" ({coverage.basis})" if coverage.basis else ""
    rows.append(("ratings", f"known for {coverage.known} of {coverage.of} elements{basis}", ""))
    tables = [Table("Base case", ("quantity", "value", "where"), tuple(rows))]
    if not isinstance(feeder, Feeder) and feeder.n_regulator:
        taps = start.state.three_phase.equipment.regulators.tap[0]
        names = feeder.network.regulator.name
        rows = tuple((name, f"{tap:g}") for name, tap in zip(names, taps, strict=True))
        tables.append(Table("Taps of the regulators", ("regulator", "tap"), rows))
    by_bus = np.array([v[feeder.node_bus == i].mean() for i in range(feeder.n_bus)])
    figure = new_figure(9.0, 6.0, layout=None)
    ax = figure.add_axes((0.01, 0.02, 0.86, 0.92))
    site = [feeder.index(job.request.bus)]
    drawn = draw_feeder(ax, feeder, positions(feeder), by_bus, site, band_pu=_half_band(study))
    figure.colorbar(drawn.dots, cax=figure.add_axes((0.9, 0.15, 0.02, 0.7)), label="voltage (p.u.)")
    picture = ("The feeder in the base case: colour is voltage, the large circle is the requested bus", png(figure))
    text = f"Loads are at their nominal values, without noise. {_acting(scenario)}"
    kept = study.v_min_pu <= v[lowest] and v[highest] <= study.v_max_pu
    verdict = "within" if kept else "outside"
    answer = (
        f"Without the site, voltages are {v[lowest]:.3f} to {v[highest]:.3f} p.u., {verdict} the limits "
        f"of {study.v_min_pu:g} to {study.v_max_pu:g} p.u.{loaded}."
    )
    return Section("base-case", "Base case", answer, (text,), tuple(tables), (picture,))


def worst_window(job: Job) -> Section:
    """Distances to all limits with the requested size, and the window that comes nearest to one without control."""
    study, bus = job.study, job.request.bus
    position = study.scenario.feeder.index(bus)
    windows = study_windows(study, position, job.sized)
    site = AddedSite(study, windows)
    site.exempt = overloaded_nodes(site)
    samples = np.arange(len(windows))
    at_bus = np.full_like(samples, position)
    controllers = job.controllers()
    trials = {name: run_trial(site, law, job.sized, at_bus, samples, name) for name, law in controllers}
    mw = site.mw(job.sized)
    limits = limits_table(study, windows, f"Nearest approach to each limit with {mw:g} MW at bus {bus}", trials)
    first = job.request.controllers[0]
    worst = int(trials[first].margins.min(axis=1).argmin())
    said = []
    for name, trial in trials.items():
        broken = int((trial.outside > 0).sum())
        said.append(
            f"with {mw:g} MW {under(name)}, {broken} of {len(windows)} windows break a limit; "
            f"the nearest limit is {nearest(study, windows, trial)}"
        )
    time = time_of(study, windows, worst)
    begins = time if windows.hours is None else f"begins at {time}"
    scenario = job.scenario(job.request.mw, **study.window_fields | _begin(study, windows, worst))
    series = {name: rollout(scenario, law, [worst], name=name).series(0) for name, law in controllers}
    text = (
        f"All {len(windows)} windows were simulated with {mw:g} MW, the requested size in steps of the study. "
        f"{windows_text(study, windows)} The figure and the metrics are those of window {worst} "
        f"({begins}), which comes nearest to a limit {under(first)}. The site is at its full "
        f"rating from {study.full_load_s[0]:g} to {study.full_load_s[1]:g} s."
    )
    caption = (
        "Voltages, power and set points in the worst window. Dashed lines are the band that controllers keep; J is the "
        "cost that they minimise."
    )
    tables = (limits, _metrics(series, "Metrics of the worst window", _outside(scenario)))
    pictures = ((caption, png(run_figure(scenario, series, worst))),)
    texts = (text, *_on_files(site.scenario(0)))
    return Section("worst-window", "Worst window", sentences(said), texts, tables, pictures)


def _on_files(scenario: Scenario) -> tuple[str, ...]:
    """Paragraphs on recordings that are repeated or run on a clock."""
    return tuple(sentences((line,)) for line in recording_lines(scenario))


def _begin(study: Study, windows: Windows, window: int) -> dict[str, Any]:
    """Fields of a scenario whose episodes begin like a window."""
    if windows.begin_h is None:
        return {}
    still = {"background.load_sigma": 0.0} if windows.still[window] else {}
    field = "background.start_hour" if study.scenario.load_profiles.file is None else "load_profiles.start_h"
    return still | {field: float(windows.begin_h[window])}


def day(job: Job) -> Section:
    """A day with and without the site at its full rating: voltages, loadings, losses, taps."""
    study = job.study
    which, begin = _worst_day(study)
    changes: dict[str, Any] = {
        "dt_s": DAY_DT_S, "horizon": DAY_STEPS, "workload.full_load_s": (0.0, DAY_DT_S * DAY_STEPS),
    } | begin  # fmt: skip
    series = {}
    for name, mw in (("without the site", 0.0), (f"with {job.request.mw:g} MW", job.request.mw)):
        series[name] = rollout(job.scenario(mw, **changes), NoControl(), [0]).series(0)
    other = "the hour of the day" if study.scenario.load_profiles.file is None else "the load profiles"
    text = (
        f"{which} in steps of a minute. The other loads follow {other}, and the site draws its full rating "
        "all day, without control: sites rarely do, so losses are upper values. Changes within a minute do not count."
    )
    metrics = _metrics(series, "Metrics of the day", _outside(study.scenario))
    tables = [_day_limits(study, series), *_day_taps(study, series), metrics]
    loss = [run.loss_kw.sum() * DAY_DT_S / 3600.0 for run in series.values()]
    answer = f"Losses of a day {rise_or_fall(*loss)} from {loss[0]:.0f} to {loss[1]:.0f} kWh"
    if len(tables) == 3:
        taps = [int(run.three_phase.equipment.regulators.moved[1:].sum()) for run in series.values()]
        answer += f", and the regulators make {taps[1]} instead of {taps[0]} taps a day ({taps[1] - taps[0]:+d})"
    return Section(
        "day", "A day at the full rating", f"{answer}.", (text,), tuple(tables),
        (("Lowest and highest voltage over the day", png(_day_figure(study, series))),),
    )  # fmt: skip


def _worst_day(study: Study) -> tuple[str, dict[str, Any]]:
    """Return the day of the lowest voltage of the load profiles, or the standard day, as text and as fields."""
    table = study.scenario.load_profiles.file
    if table is None:
        return "One day", {"background.start_hour": 0.0}
    hours = load_hours(dataclasses.replace(study, load="day") if study.load == "peak" else study)
    lowest = (h for h, reason in zip(hours.hours, hours.reasons, strict=True) if "lowest voltage" in reason)
    hour = float(next(lowest, hours.hours[0]))
    end_h, day_h = table.begin_h + table.duration_h, 24.0 * np.floor(hour / 24.0)
    begin_h = max(table.begin_h, min(day_h, end_h - 24.0))
    steps = min(DAY_STEPS, int((end_h - begin_h) * 60.0 + 1e-9))
    which = f"The {'day' if steps == DAY_STEPS else f'{steps / 60.0:g} h'} from {time_text(study.scenario, begin_h)} on"
    return f"{which}, in which a power flow of each sample without the site gives the lowest voltage,", {
        "background.start_hour": None, "load_profiles.start_h": float(begin_h), "horizon": steps,
        "workload.full_load_s": (0.0, DAY_DT_S * steps),
    }  # fmt: skip


def ride_through(job: Job) -> Section:
    """Recorded sags, by which the site leaves the grid and comes back."""
    study, rule = job.study, job.request.ride_through
    scenario = job.scenario(
        job.request.mw, horizon=round(RIDE_THROUGH_S / study.scenario.dt_s), sags=rule.sags,
        **NOMINAL,
        **{"datacenters.ride_through": {"curve": rule.curve}, "workload.full_load_s": (0.0, RIDE_THROUGH_S)},
    )  # fmt: skip
    series = {name: rollout(scenario, controller, [0], name=name).series(0) for name, controller in job.controllers()}
    text = (
        f"The site follows the curve {rule.curve} during the sags {rule.sags}, at nominal load and at its full "
        "rating, which gives the largest loss of load. It leaves the grid when the curve's time is over, continues on "
        "battery and comes back by the rule of docs/ride-through.md, which also has the sources of curves and sags. No "
        "controller can prevent a sag; it changes the voltages after the loss and the return."
    )
    name, run = next(iter(series.items()))
    first, control = run.metrics(), under(name)
    trips = int(first["ups_trips"])
    if trips:
        answer = (
            f"By the curve {rule.curve}, the sags {rule.sags} disconnect the site {trips} "
            f"time{'s' * (trips > 1)}, and {first['ups_lost_step_kw']:.0f} kW are lost in the largest step, {control}."
        )
    else:
        answer = f"By the curve {rule.curve}, the site stays connected during the sags {rule.sags} {control}."
    tables = (_curve(rule.curve), _metrics(series, "Metrics of the sags", _outside(scenario)))
    return Section("ride-through", "Ride-through and return", answer, (text,), tables)


def fluctuation(job: Job) -> Section:
    """Ramps, voltage steps and flicker in ten minutes of the trace, against the request's limits."""
    limits = job.request.limits
    cost = {"ramp_window_s": limits.ramp_window_s, "voltage_step_limit_pu": limits.voltage_step_pct / 100.0}
    ramp = limits.ramp_kw_per_s
    cost["ramp_limit_kw_per_s"] = 1000.0 * job.request.mw if ramp is None else ramp
    scenario = job.scenario(job.request.mw, dt_s=FLICKER_DT_S, horizon=FLICKER_STEPS, cost=cost, **NOMINAL)
    rows, exceeded = [], []
    for name, controller in job.controllers():
        m = rollout(scenario, controller, [0], name=name).metrics()[0]
        rows.append((name, figure_of(m["ramp_max_kw_per_s"]), figure_of(m["voltage_step_max_pu"] * 100.0),
                     figure_of(m["pst_max"])))  # fmt: skip
        over = {
            "the ramp": ramp is not None and m["ramp_max_kw_per_s"] > ramp,
            "the voltage change": m["voltage_step_max_pu"] * 100.0 > limits.voltage_step_pct,
            "Pst": m["pst_max"] > limits.pst,
        }
        exceeded += [f"{limit} {under(name)}" for limit, is_over in over.items() if is_over]
    allowed = ("limit", "none stated" if ramp is None else figure_of(ramp), figure_of(limits.voltage_step_pct),
               figure_of(limits.pst))  # fmt: skip
    header = ("controller", f"largest ramp over {limits.ramp_window_s:g} s, kW/s",
              f"largest voltage change in {FLICKER_DT_S:g} s, %", "largest short-term flicker Pst")  # fmt: skip
    text = (
        f"Ten minutes of the trace in steps of {FLICKER_DT_S:g} s, at nominal load. Source of the limits: "
        f"{limits.source}; limits that the study's file does not set are defaults of dcgrid study. Pst is that of "
        "IEC 61000-4-15 for a lamp of 120 V and 60 Hz, without fluctuations above 5 Hz."
    )
    source = "defaults of dcgrid study" if limits.source == NOT_STATED else limits.source
    answer = f"Above the limits ({source}): {', '.join(exceeded)}." if exceeded else f"Within the limits ({source})."
    if ramp is None:
        answer += " No limit of ramps is stated."
    tables = (Table("Largest values in ten minutes", header, (*rows, allowed)),)
    return Section("fluctuation", "Ramps and flicker", answer, (text, *_on_files(scenario)), tables)


def sensitivity(job: Job) -> Section:
    """How the snapshot's capacity at the bus changes with the assumptions."""
    study = with_same_hours(job.study)
    base = study.scenario
    cases: list[tuple[str, Study]] = [("as assumed", study)]
    for percent in (-1.0, 1.0):
        source = base.source_voltage_pu * (1.0 + percent / 100.0)
        changed = with_same_hours(study, scenario=base.replace(source_voltage_pu=source))
        cases.append((f"source voltage {percent:+g} %", changed))
    for change in (-0.01, 0.01):
        changed = with_same_hours(study, v_min_pu=study.v_min_pu + change)
        cases.append((f"lowest allowed voltage {study.v_min_pu + change:g} p.u.", changed))
    for percent in (0.9 * study.loading_max_pct, 1.1 * study.loading_max_pct):
        changed = with_same_hours(study, loading_max_pct=percent)
        cases.append((f"loading up to {percent:g} % of the ratings", changed))
    bus = np.array([base.feeder.index(job.request.bus)])
    rows = []
    for name, changed in cases:
        (capacity,) = snapshot_capacity(changed, bus)
        rows.append(
            (name, f"{'>=' if capacity.at_most else ''}{capacity.capacity_mw:g}", capacity.limit or "none found")
        )
    text = (
        f"Capacity of bus {job.request.bus} in one power flow at the worst hour without control, one assumption "
        "changed at a time. Windows and controllers give other sizes; the differences between the rows are what counts "
        "here."
    )
    mw = [row[1].replace(">=", "at least ") for row in rows]
    answer = (
        f"In a snapshot the bus carries {mw[0]} MW, {mw[1]} MW with 1 % less source voltage and {mw[2]} MW with 1 % "
        "more."
    )
    return Section(
        "sensitivity", "Sensitivity to assumptions", answer, (text,),
        (Table("Snapshot capacity", ("assumption", "MW", "limit"), tuple(rows)),),
    )  # fmt: skip


BUILDERS: dict[str, Callable[[Job], Section]] = {
    "base-case": base_case,
    "worst-window": worst_window,
    "day": day,
    "year": year,
    "ride-through": ride_through,
    "fluctuation": fluctuation,
    "sensitivity": sensitivity,
    "several-sites": several_sites,
}
"""Sections that need the request and the study alone."""


def _acting(scenario: Scenario) -> str:
    """Return a sentence on the equipment whose built-in control acts."""
    modes = scenario.grid_control.capacitors
    acting = ["regulators"] * (acting_relays(scenario) is not None)
    acting += ["capacitor banks"] * ("controlled" in (dict(modes).values() if isinstance(modes, tuple) else (modes,)))
    return f"Nothing is controlled except {' and '.join(acting)}." if acting else "Nothing is controlled."


def _half_band(study: Study) -> float:
    return max(study.v_max_pu - 1.0, 1.0 - study.v_min_pu)


def _outside(scenario: Scenario) -> str:
    """A note on the metrics' band, which differs from the limits of the study."""
    band = scenario.cost.band_pu
    return (
        f"In these metrics, outside means outside {1.0 - band:g} to {1.0 + band:g} p.u., the band of the controllers."
    )


def _metrics(series: dict[str, Any], title: str, note: str) -> Table:
    """The metrics of some runs, a column for each."""
    figures = {name: run.metrics() for name, run in series.items()}
    first = next(iter(figures.values()))
    rows = [
        (
            metric.label,
            metric.unit,
            *(metric.text(metric.of_episodes([metrics[metric.name]])) for metrics in figures.values()),
        )
        for metric in metrics_in("run")
        if metric.name in first and metric.name != "J"
    ]
    return Table(title, ("metric", "unit", *figures), tuple(rows), (note,))


def _curve(name: str) -> Table:
    """The thresholds of a ride-through curve."""
    curve = UpsRideThrough(curve=name).curve
    rows = [(f"below {v:g} p.u.", f"{s:g} s") for v, s in curve.under]
    rows += [(f"above {v:g} p.u.", f"{s:g} s") for v, s in curve.over]
    return Table(f"Ride-through curve {name}", ("voltage", "stays connected for"), tuple(rows))


def _day_limits(study: Study, series: dict[str, Any]) -> Table:
    """The day against the limits of the study, a column for each run."""
    feeder, columns = study.scenario.feeder, []
    for run in series.values():
        v = run.v_pu[1:, feeder.load_slice]
        low, high = (v < study.v_min_pu).any(axis=1).sum(), (v > study.v_max_pu).any(axis=1).sum()
        column = [f"{low}", f"{high}"]
        if study.coverage.known:
            loading = run.loading[1:].max(axis=0)
            most = int(loading.argmax())
            column.append(f"{100.0 * loading[most]:.1f} % of the rating, {branch_to(feeder, most)}")
        columns.append([*column, f"{run.loss_kw.sum() * DAY_DT_S / 3600.0:.0f} kWh"])
    names = [
        f"minutes with a voltage below {study.v_min_pu:g} p.u.",
        f"minutes with a voltage above {study.v_max_pu:g} p.u.",
    ]
    names += ["highest loading"] * (len(columns[0]) == 4) + ["losses"]
    return Table("The day against the limits", ("quantity", *series), tuple(zip(names, *columns, strict=True)))


def _day_taps(study: Study, series: dict[str, Any]) -> list[Table]:
    """The taps of each regulator in a day; no table on a feeder without regulators."""
    feeder = study.scenario.feeder
    if isinstance(feeder, Feeder) or not feeder.n_regulator:
        return []
    without, sited = (run.three_phase.equipment.regulators.moved[1:].sum(axis=0) for run in series.values())
    rows = [
        (name, f"{a:g}", f"{b:g}", f"{b - a:+g}")
        for name, a, b in zip(feeder.network.regulator.name, without, sited, strict=True)
    ]
    rows.append(("all", f"{without.sum():g}", f"{sited.sum():g}", f"{sited.sum() - without.sum():+g}"))
    return [Table("Taps of the regulators in a day", ("regulator", *series, "difference"), tuple(rows))]


def _day_figure(study: Study, series: dict[str, Any]) -> Figure:
    figure = new_figure(9.0, 4.0)
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
