"""The section of a connection study on a year of load profiles: power flows of all samples, then the worst hours."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dcgrid_env import acting_relays, profile_coverage
from dcgrid_env.apps.hosting.capacity_study import Study
from dcgrid_env.apps.hosting.connection_study.section import Section, figure_of, rise_or_fall
from dcgrid_env.apps.hosting.connection_study.study_job import Job
from dcgrid_env.apps.hosting.year_flow import YearFlow, hour_scenario, year_flow
from dcgrid_env.baselines.rollout import rollout
from dcgrid_env.core.figure_axes import new_figure
from dcgrid_env.core.html_page import png
from dcgrid_env.core.text_table import Table

_METRICS = ("voltage_min_pu", "voltage_max_pu", "loss_mean_kw")
"""Metrics of the simulated hours."""


def year(job: Job) -> Section:
    """A year by the load profiles, with and without the site."""
    study, with_site, size = job.study, job.scenario(job.request.mw), f"with {job.request.mw:g} MW"
    flows = {"without the site": year_flow(job.scenario(0.0)), size: year_flow(with_site)}
    last = flows[size]
    limits = (study.v_min_pu, study.v_max_pu, study.loading_max_pct / 100.0)
    table = with_site.load_profiles.table
    acts = acting_relays(with_site) is not None
    regulators = "Regulators follow their control within a day and have settled at its begin. " * acts
    texts = (
        f"{len(table.values)} power flows in steps of {table.step_s / 60.0:g} min by the load profiles of "
        f"{Path(table.label).name}, without control and without noise. The site draws its full rating all the time. "
        f"{regulators}{profile_coverage(with_site)}.",
        "The worst hours are then simulated in steps of a second with the trace of the site, which draws its full "
        "rating in the middle third of the hour.",
    )
    tables = [_counts(flows, limits), _worst(flows), *_simulated(last, job.controllers())]
    picture = ("Lowest and highest voltage of each day of the load profiles", png(_figure(flows, study)))
    both = (last, flows["without the site"])
    hours = [[f"{value:g}" for value in flow.hours_outside(*limits).values()] for flow in both]
    loss, change = [figure_of(flow.loss_mwh) for flow in both], rise_or_fall(both[1].loss_mwh, both[0].loss_mwh)
    unsolved_h = [float((~flow.solved).sum()) * flow.step_h for flow in both]
    answer = (
        f"Over the load profiles {size}, voltages are below the limit for {hours[0][0]} h and above it for "
        f"{hours[0][1]} h, and ratings are exceeded for {hours[0][2]} h. Without the site these are "
        f"{hours[1][0]}, {hours[1][1]} and {hours[1][2]} h. Losses {change} from {loss[1]} to {loss[0]} MWh."
    )
    if any(unsolved_h):
        answer += (
            f" These figures leave out {unsolved_h[0]:g} h {size}, and {unsolved_h[1]:g} h without the site, that have "
            "no power-flow solution or follow one without in the day."
        )
    return Section("year", "All hours of the load profiles", answer, texts, tuple(tables), (picture,))


def _counts(flows: dict[str, YearFlow], limits: tuple[float, float, float]) -> Table:
    columns = [flow.hours_outside(*limits) for flow in flows.values()]
    rows: list[tuple[str, ...]] = [(f"hours {name}", *(f"{hours[name]:g}" for hours in columns)) for name in columns[0]]
    rows.append(("energy lost, MWh", *(figure_of(flow.loss_mwh, 5) for flow in flows.values())))
    return Table("Hours beyond limits, and losses", ("quantity", *flows), tuple(rows))


def _worst(flows: dict[str, YearFlow]) -> Table:
    rows = [
        (case, quantity, flow.value(quantity, sample), flow.time_text(sample))
        for case, flow in flows.items()
        for quantity, sample in flow.worst().items()
    ]
    return Table("Worst samples", ("case", "quantity", "value", "time"), tuple(rows))


def _simulated(flow: YearFlow, controllers: Sequence[tuple[str, Any]]) -> list[Table]:
    """Return the metrics of the worst hours in steps of a second; each hour once."""
    by_hour: dict[float, list[str]] = {}
    samples: dict[float, int] = {}
    for quantity, sample in flow.worst().items():
        scenario = hour_scenario(flow.scenario, flow, sample)
        begin_h = float(scenario.load_profiles.start_h or 0.0)
        by_hour.setdefault(begin_h, []).append(quantity)
        samples.setdefault(begin_h, sample)
    rows = []
    for begin_h, quantities in by_hour.items():
        scenario = hour_scenario(flow.scenario, flow, samples[begin_h])
        for name, controller in controllers:
            run = rollout(scenario, controller, [0], name=name).series(0)
            figures = run.metrics()
            loading = "" if run.loading is None else f"{100.0 * float(np.max(run.loading)):.1f}"
            change = float(np.abs(np.diff(run.v_pu[:, scenario.feeder.load_slice], axis=0)).max())
            row = (*(figure_of(figures[metric]) for metric in _METRICS), figure_of(change), loading)
            rows.append((", ".join(quantities), flow.time_text(samples[begin_h]), name, *row))
    header = (
        "hour of the", "sample", "controller", "lowest voltage, p.u.", "highest voltage, p.u.",
        "mean loss, kW", "largest voltage change in 1 s, p.u.", "highest loading, %",
    )  # fmt: skip
    return [Table("Worst hours in steps of a second", header, tuple(rows))] if rows else []


def _figure(flows: dict[str, YearFlow], study: Study) -> Figure:
    figure = new_figure(9.0, 4.0)
    ax = figure.subplots()
    for (name, flow), colour in zip(flows.items(), ("#0072B2", "#D55E00"), strict=True):
        day = np.floor(flow.hours / 24.0 + 1e-9).astype(int)
        days = np.unique(day)
        lowest = [np.min(flow.v_min_pu[day == d]) for d in days]
        highest = [np.max(flow.v_max_pu[day == d]) for d in days]
        ax.plot(days + 1, lowest, color=colour, linewidth=1.0, label=name)
        ax.plot(days + 1, highest, color=colour, linewidth=1.0)
    for limit in (study.v_min_pu, study.v_max_pu):
        ax.axhline(limit, color="#444444", linewidth=0.8, linestyle="--")
    ax.set_xlabel("day of the load profiles")
    ax.set_ylabel("lowest and highest voltage (p.u.)")
    ax.grid(alpha=0.25)
    ax.legend(frameon=False)
    return figure
