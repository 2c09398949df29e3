"""Tables of the benchmark's pages, made from docs/benchmarks when the site is built."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dcgrid_env.apps.benchmark.summary import BestKnownCost, Hindsight
from dcgrid_env.baselines.score import REFERENCE
from docs.studies.publishing.benchmark_data import FOLDER, METRICS_SHOWN, BenchmarkData, Row
from docs.studies.publishing.site_tables import NONE, number, plain, sortable, unbroken, with_interval

if TYPE_CHECKING:
    from sphinx.application import Sphinx

HOW_TO_READ = (
    f"J is the mean cost per test episode: lower is better. The score is 0 for `{REFERENCE}`, the droop law with tuned "
    "gains. It is 1 for {}. *J saved* is the cost that a controller saves, in per cent of the cost of "
    f"`{REFERENCE}`. Read both: if the headroom is small, a score of 1 saves little. Parentheses contain 95 % "
    "intervals over test episodes. [Results](results.md) explains the scores."
)
FORESIGHT = "hindsight, which optimises each episode with perfect foresight"
BEST_KNOWN = (
    "No linear program describes {}. The best known cost of an episode is the lowest that a search and controllers "
    "found. It is not an upper bound: a controller can score more than 1."
)
GAP = (
    " Hindsight solves a linearised program and replays its actions in the environment. The gap is the largest "
    "difference between the two costs in an episode."
)
SORT = "Select a column heading to sort a table. The lists above a table filter its rows."


def tables(data: BenchmarkData) -> str:
    """What follows a page's introduction, as MyST Markdown."""
    unsolved = [f"`{name}`" for name, facts in data.scenarios.items() if isinstance(facts.hindsight, BestKnownCost)]
    best = "the best known cost" if len(unsolved) == len(data.scenarios) else FORESIGHT
    parts = [HOW_TO_READ.format(best), *[BEST_KNOWN.format(", ".join(unsolved))] * bool(unsolved)]
    parts += [f"    {data.command}", versions(data), "## Presets", presets(data)]
    if len(data.scenarios) > 1:
        parts += ["## Scores", overview(data)]
    parts += ["## All results", SORT, results(data), *left_out(data), "## Columns", columns()]
    return "\n\n".join(part for part in parts if part) + "\n"


def versions(data: BenchmarkData) -> str:
    """Versions of Python and packages behind the figures; empty if the run did not record them."""
    named = ", ".join(f"{name} {version}" for name, version in data.versions.items())
    return f"Run with {named}." if named else ""


def presets(data: BenchmarkData) -> str:
    """Costs between which the scores of each preset lie."""
    is_solved = any(isinstance(facts.hindsight, Hindsight) for facts in data.scenarios.values())
    best = "hindsight" if is_solved else "best known"
    head = ["preset", "episodes", "J: none", f"J: {REFERENCE}", f"J: {best}", "headroom, %"]
    head += ["optimum of the program", "largest gap, %"] * is_solved
    rows = []
    for name, (episodes, hindsight, _) in data.scenarios.items():
        found, shares = data.of(name), [number(data.headroom_pct(name), 1)]
        if isinstance(hindsight, Hindsight):
            shares += [number(hindsight.optimum, 4), number(hindsight.gap_pct, 2)]
        costs = (found["none"].means["J"], found[REFERENCE].means["J"], hindsight.J)
        cells = [f"[{name}](environments/{name}.myst)", str(episodes), *(number(j, 4) for j in costs), *shares]
        rows.append([*cells, *[NONE] * (len(head) - len(cells))])
    about = f"The headroom is J saved at a score of 1.{GAP * is_solved}"
    return f"{sortable(head, rows)}\n\n{about}"


def overview(data: BenchmarkData) -> str:
    """Scores without intervals: a row for each controller, a column for each preset."""
    found = {(row.scenario, row.controller): number(row.score.value, 2) for row in data.rows}
    names = dict.fromkeys(row.controller for row in data.rows)
    rows = [(f"`{name}`", *(found.get((preset, name), NONE) for preset in data.scenarios)) for name in names]
    return sortable(("controller", *data.scenarios), rows)


def results(data: BenchmarkData) -> str:
    """Every figure: the presets in their order, on each the highest score first."""
    many = len(data.scenarios) > 1
    head = ["controller", *["preset"] * many, "score", "J saved, %", "J", "IQM of J"]
    head += [*(plain(metric.column) for metric in METRICS_SHOWN), "observes"]
    rows = []
    for name, facts in data.scenarios.items():
        best_first = sorted(data.of(name).values(), key=lambda row: -row.score.value)
        blank = [NONE] * (1 + len(METRICS_SHOWN))
        known = "best known" if isinstance(facts.hindsight, BestKnownCost) else "hindsight"
        best = [known, *[name] * many, "1.000", number(data.headroom_pct(name), 1), number(facts.hindsight.J, 4)]
        rows += [[*best, *blank, "the whole episode"], *(_cells(row, many) for row in best_first)]
    return sortable(head, rows)


def _cells(row: Row, many: bool) -> list[str]:
    means = row.means
    return [
        f"`{row.controller}`", *[row.scenario] * many, with_interval(row.score, 3), with_interval(row.saved_pct, 1),
        number(means["J"], 4), number(means["interquartile_mean"], 4),
        *(metric.text(means[metric.name]) for metric in METRICS_SHOWN), unbroken(row.observes),
    ]  # fmt: skip


def left_out(data: BenchmarkData) -> list[str]:
    """A sentence on controllers that apply to none of the presets, and one on each that does not apply to some."""
    what = "any of these presets" if len(data.scenarios) > 1 else "this preset"
    names = ", ".join(f"`{name}`" for name in data.apply_to_none)
    sentences = [f"These controllers do not apply to {what}: {names}."] if names else []
    return sentences + [f"`{name}` does not apply to `{preset}`: {plain(why)}." for preset, name, why in data.refusals]


def columns() -> str:
    """Meaning of the columns."""
    meanings = [
        ("score", f"share of the way from `{REFERENCE}` (0) to hindsight (1), with its interval"),
        ("J saved, %", f"cost saved, in per cent of the cost of `{REFERENCE}`, with its interval"),
        ("J", "mean cost per test episode"),
        ("IQM of J", "mean over the middle half of the episodes"),
        *((plain(metric.column), metric.meaning or metric.label) for metric in METRICS_SHOWN),
        ("observes", "scope of observation; a controller with the feeder's model also receives the agents' buses"),
    ]
    lines = [f"| {name} | {meaning} |" for name, meaning in meanings]
    return "\n".join(("| column | meaning |", "|---|---|", *lines))


def add_tables(app: Sphinx, docname: str, source: list[str]) -> None:
    """Put the tables behind the text of a page that has a data file."""
    path = FOLDER / f"{docname}.json"
    if path.is_file():
        app.env.note_dependency(str(path))
        source[0] = f"{source[0].rstrip()}\n\n{tables(BenchmarkData.load(path))}"


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the function that adds the tables."""
    app.connect("source-read", add_tables)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
