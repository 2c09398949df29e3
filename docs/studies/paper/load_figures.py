"""Figures of load: generated counterparts of Figs. 1 and 2, and Fig. 7, load before and after."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from dcgrid_env import Scenario, forecast
from dcgrid_env.apps.reproduction.paper import PUBLISHED_BUSES
from dcgrid_env.apps.reproduction.study_runs import NO_CONTROL, Law, Runs
from dcgrid_env.apps.reproduction.table1 import LAWS
from dcgrid_env.core.figure_axes import label_axes, new_figure
from dcgrid_env.traces import TRACE_SOURCES
from docs.studies.paper.drawing import COLOURS, line
from docs.studies.paper.load_swings import MODELS

SITE = 85
"""Bus of Fig. 7: near the end of the feeder, where the voltage is low and the clock acts."""
PANELS = (1.0, 20.0)
"""k_p of Fig. 7, MW/p.u."""
FORMS = {"both": "after, cumulative backlog", "both-one-step": "after, printed one-step backlog"}


def training_and_inference(runs: Runs) -> Figure:
    """Fig. 1: power of a training and of an inference site, generated, as a share of the rating."""
    figure = new_figure(9.0, 5.2)
    for ax, (name, length_s, dt_s) in zip(
        figure.subplots(2, 1), (("training", 60.0, 0.1), ("inference", 600.0, 1.0)), strict=True
    ):
        share = _busiest(name, length_s, dt_s)
        ax.step(np.arange(len(share)) * dt_s, share, where="post", color=COLOURS[0], linewidth=1.1)
        label_axes(ax, "time (s)", "share of the rating", f"generated: {name}, means over {dt_s:g} s")
        ax.set_ylim(0.0, 1.05)
        ax.set_xlim(0.0, length_s)
    return figure


def _busiest(name: str, length_s: float, dt_s: float) -> np.ndarray:
    """Of the first eight seeds' traces, the one that moves most: an idle stretch would show nothing."""
    shares = [TRACE_SOURCES[name].generate(length_s, seed).resample(dt_s) for seed in range(8)]
    return max(shares, key=lambda share: float(share.std()))


def four_models(runs: Runs) -> Figure:
    """Fig. 2: four models under the same waves of queries, generated, as a share of the rating."""
    figure = new_figure(9.0, 7.0)
    axes = figure.subplots(len(MODELS), 1, sharex=True, sharey=True)
    for ax, name, colour in zip(axes, MODELS, COLOURS, strict=True):
        share = TRACE_SOURCES[name].generate(300.0, 0).resample(1.0)
        ax.step(np.arange(len(share)), share, where="post", color=colour, linewidth=1.1)
        label_axes(ax, "", "share of rating", f"generated: {name}")
    axes[-1].set_xlabel("time (s)")
    axes[-1].set_ylim(0.0, 1.05)
    axes[-1].set_xlim(0.0, 300.0)
    return figure


def all_sites(runs: Runs) -> Scenario:
    """The scenario of Figs. 6 and 7: data centres at all eight published buses, low ends among them."""
    return runs.setting.published(len(PUBLISHED_BUSES))


def episode_with_a_burst(runs: Runs, scenario: Scenario, bus: int) -> int:
    """Seed of the scenario in whose episode the load of the data centre at ``bus`` moves most."""
    assert scenario.datacenters.buses is not None
    site = scenario.datacenters.buses.index(str(bus))
    spread = [forecast(scenario, seed).p_ref_kw[:, site].std() for seed in range(runs.setting.episodes)]
    return int(np.argmax(spread))


def panel_laws() -> list[Law]:
    """The laws of Fig. 7."""
    return [LAWS[name]._replace(k_p_mw_per_pu=k_p) for k_p in PANELS for name in FORMS]


def before_and_after(runs: Runs, seed: int) -> Figure:
    """Fig. 7: power of a data centre before and after control at k_p = 1 and 20, and what waits."""
    scenario, site = all_sites(runs), PUBLISHED_BUSES.index(SITE)
    figure = new_figure(11.0, 5.6)
    axes = figure.subplots(2, 2, sharex=True, sharey="row")
    before = runs.series(scenario, NO_CONTROL, seed)
    t = np.arange(1, len(before.p_kw) + 1) * scenario.dt_s
    for (power, waiting), k_p in zip(axes.T, PANELS, strict=True):
        for name, label in FORMS.items():
            after = runs.series(scenario, LAWS[name]._replace(k_p_mw_per_pu=k_p), seed)
            power.step(t, after.p_kw[:, site], where="pre", label=label, **line(name))
            waiting.plot(t, after.backlog_kws[1:, site], **line(name))
        power.step(t, before.p_kw[:, site], where="pre", label="before", **line("none"))
        label_axes(power, "", "power (kW)", f"k_p = {k_p:g} MW/p.u., bus {SITE}")
        label_axes(waiting, "time (s)", "backlog (kW s)")
    axes[0, 0].set_ylim(0.0, None)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    return figure
