"""What each controller costs on a preset, read from the benchmark's data files and the cards of bundled policies."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

from dcgrid_env import make_scenario
from dcgrid_env.agents.policy.card import Card, Scored
from dcgrid_env.agents.policy.policy import FOLDER
from dcgrid_env.apps.benchmark.summary import BestKnownCost
from dcgrid_env.baselines.score import REFERENCE, STATIC, saved_pct
from dcgrid_env.baselines.tuning.tuned import tuned_parameters
from docs.studies.publishing.benchmark_data import BenchmarkData, Row, all_data


class Line(NamedTuple):
    """A line of the table of headroom."""

    what: str
    """Name of the controller, as Markdown."""
    meaning: str
    j: str
    saved: str
    """J saved, per cent of the tuned droop's."""
    score: str
    """With its 95 % interval."""


class Headroom(NamedTuple):
    """Scores of the main controllers on a preset."""

    page: str
    """Page of the benchmark that has every controller, without its suffix."""
    episodes: int
    rows: tuple[Line, ...]


@cache
def pages() -> dict[str, tuple[str, BenchmarkData]]:
    """Page and data of the benchmark of each preset."""
    return {preset: (page, data) for page, data in all_data().items() for preset in data.scenarios}


def headroom(preset: str) -> Headroom:
    """Read what none, the tuned droop, the best constant, hindsight and the best policy score on a preset.

    Raises
    ------
    ValueError
        If no data file contains the preset.
    """
    page, data = page_of(preset)
    figures = data.of(preset)
    droop = figures[REFERENCE].means["J"]
    static = max((name for name in STATIC if name in figures), key=lambda name: figures[name].score.value)
    about = {
        "none": "no control: top clock, no reactive power",
        REFERENCE: f"the droop law of Chen and Zhang, gains tuned on validation: {gains(preset)}",
        static: "best constant set points, no measurements",
    }
    rows = [
        line(f"`{name}`", meaning, figures[name].means["J"], droop, shown(figures[name].score))
        for name, meaning in about.items()
    ]
    if (best := best_policy(preset)) is not None:
        name, scored = best
        rows.append(line(f"`{name}`", "the best bundled policy", scored.J, droop, shown(scored.score)))
    known, j = hindsight(preset)
    meaning = "the lowest cost found by search, not a bound" if known else "perfect foresight of the episode"
    rows.append(line("best known" if known else "hindsight", meaning, j, droop, "1"))
    return Headroom(page, data.scenarios[preset].episodes, tuple(rows))


def gains(preset: str) -> str:
    """Return the gains of the tuned droop."""
    tuned = tuned_parameters("droop", make_scenario(preset)).parameters
    k_p, k_q, alpha = (tuned[name] for name in ("k_p_mw_per_pu", "k_q_mvar_per_pu_s", "alpha_per_s"))
    return f"k_p {k_p:.4g} MW/p.u., k_q {k_q:.4g} Mvar/(p.u. s), alpha {alpha:.4g} /s"


def line(what: str, meaning: str, j: float, j_droop: float, score: str) -> Line:
    """A line of the table."""
    return Line(what, meaning, f"{j:.4f}", saved(j, j_droop), score)


def shown(score: tuple[float, float, float]) -> str:
    """A score with its interval."""
    value, low, high = score
    return f"{value:.3f} ({low:.3f} to {high:.3f})"


def page_of(preset: str) -> tuple[str, BenchmarkData]:
    """Page of the benchmark with a preset, and its data."""
    if preset not in pages():
        raise ValueError(f"no file of docs/benchmarks contains preset {preset!r}; run dcgrid benchmark on it")
    return pages()[preset]


def controllers(preset: str) -> dict[str, Row]:
    """Result of each controller that applies to a preset."""
    return page_of(preset)[1].of(preset)


def hindsight(preset: str) -> tuple[bool, float]:
    """Whether the best known cost replaces hindsight on a preset, and its mean J."""
    costs = page_of(preset)[1].scenarios[preset].hindsight
    return isinstance(costs, BestKnownCost), costs.J


def saved(j: float, j_droop: float) -> str:
    """What is saved of the tuned droop's J, %."""
    return f"{saved_pct(j, j_droop):.1f}"


def best_policy(preset: str) -> tuple[str, Scored] | None:
    """Name and results of the bundled policy with the highest score on a preset; None without bundled policies."""
    scored = {path.stem: Card.load(path).scored for path in sorted(FOLDER.glob("*.json"))}
    results = {name: result for name, result in scored.items() if result is not None and result.scenario == preset}
    return max(results.items(), key=lambda item: item[1].score[0], default=None)


def shown_controller(preset: str) -> str:
    """Name of the controller in the animation of a preset: the best bundled policy, or the tuned droop."""
    best = best_policy(preset)
    return REFERENCE if best is None else best[0]
