"""Published results of ``dcgrid benchmark``: one data file for each page of the site.

The pages and the tables of other pages are made of these files (docs/extensions). Nobody edits them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

import tyro

from dcgrid_env import PRESETS, make_scenario, metrics_in, scenario_hash
from dcgrid_env.apps.benchmark.summary import BestKnownCost, Hindsight, hindsight_costs
from dcgrid_env.baselines import published
from dcgrid_env.baselines.score import REFERENCE, SPLIT, Estimate, saved_pct
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.terminal import plain_console, say
from dcgrid_env.core.files import write_text

FOLDER = Path(__file__).parents[2] / "benchmarks"
"""Data files; each has the name of its page."""
METRICS_SHOWN = metrics_in("benchmark")
FIGURES = ("J", "interquartile_mean", *(metric.name for metric in METRICS_SHOWN))
"""Means over episodes."""
ESTIMATES = ("score", "saved_pct")
COLUMNS = (
    "scenario", "controller", "observes", *(f"{name}{end}" for name in ESTIMATES for end in ("", "_low", "_high")),
    *FIGURES,
)  # fmt: skip
"""Columns of a row in a data file."""
DIGITS = 9
"""Significant digits of a figure in a data file: so many that pages do not round a rounded figure."""


class Row(NamedTuple):
    """Result of one controller on one scenario."""

    scenario: str
    controller: str
    observes: str
    score: Estimate
    saved_pct: Estimate
    means: Mapping[str, float]
    """A mean over episodes for each of ``FIGURES``."""


class Facts(NamedTuple):
    """What the results of one scenario have in common."""

    episodes: int
    hindsight: Hindsight | BestKnownCost
    scenario_hash: str = ""
    """Empty if the run did not record it."""


class Refusal(NamedTuple):
    """A controller that applies to other scenarios of the run but not to this one."""

    scenario: str
    controller: str
    reason: str


@dataclass(frozen=True)
class BenchmarkData:
    """Results of one run of ``dcgrid benchmark``."""

    command: str
    versions: Mapping[str, str]
    """Empty if the run did not record them."""
    scenarios: Mapping[str, Facts]
    apply_to_none: tuple[str, ...]
    """Controllers that apply to none of the scenarios."""
    refusals: tuple[Refusal, ...]
    rows: tuple[Row, ...]

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a data file."""
        content = json.loads(path.read_text(encoding="utf-8"))
        scenarios = {}
        for name, facts in content["scenarios"].items():
            hindsight = Hindsight(**facts["hindsight"]) if "hindsight" in facts else BestKnownCost(facts["best_known"])
            scenarios[name] = Facts(facts["episodes"], hindsight, facts["scenario_hash"])
        rows = []
        for values in content["rows"]:
            row = dict(zip(content["columns"], values, strict=True))
            score, saved = (Estimate(row[name], row[f"{name}_low"], row[f"{name}_high"]) for name in ESTIMATES)
            means = {name: row[name] for name in FIGURES}
            rows.append(Row(row["scenario"], row["controller"], row["observes"], score, saved, means))
        refusals = tuple(Refusal(*words) for words in content["refusals"])
        unused = tuple(content["apply_to_none"])
        return cls(content["command"], content["versions"], scenarios, unused, refusals, tuple(rows))

    def save(self, path: Path) -> None:
        """Write a data file, one line for each row."""
        scenarios = {}
        for name, (episodes, hindsight, digest) in self.scenarios.items():
            known = {key: _rounded(value) for key, value in hindsight._asdict().items()}
            costs = {"best_known": known["J"]} if isinstance(hindsight, BestKnownCost) else {"hindsight": known}
            scenarios[name] = {"episodes": episodes, "scenario_hash": digest} | costs
        parts = {
            "command": self.command, "versions": self.versions, "scenarios": scenarios,
            "apply_to_none": self.apply_to_none, "refusals": self.refusals, "columns": COLUMNS,
        }  # fmt: skip
        head = "".join(f"{json.dumps(key)}: {json.dumps(value, ensure_ascii=False)},\n" for key, value in parts.items())
        rows = ",\n".join(json.dumps(_values(row), ensure_ascii=False) for row in self.rows)
        write_text(path, f'{{\n{head}"rows": [\n{rows}\n]\n}}\n')

    def of(self, scenario: str) -> dict[str, Row]:
        """Rows of one scenario, by controller."""
        return {row.controller: row for row in self.rows if row.scenario == scenario}

    def headroom_pct(self, scenario: str) -> float:
        """Share of the reference's cost that hindsight saves, %."""
        return saved_pct(self.scenarios[scenario].hindsight.J, self.of(scenario)[REFERENCE].means["J"])


def _values(row: Row) -> list[str | float]:
    figures = [*row.score, *row.saved_pct, *(row.means[name] for name in FIGURES)]
    return [row.scenario, row.controller, row.observes, *map(_rounded, figures)]


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}") + 0.0


def from_results(content: Mapping[str, Any], name: str) -> BenchmarkData:
    """Data of a run, from its results.json.

    Parameters
    ----------
    content
        Content of the file.
    name
        Name of the page.

    Raises
    ------
    ValueError
        If a controller failed or has no score, or if a scenario is not a preset or has changed since the run.
    """
    if not isinstance(content, Mapping) or not {"meta", "failures", "summaries"} <= content.keys():
        raise ValueError("meta, failures or summaries is missing; pass results.json of dcgrid benchmark")
    meta, rows, refusals = content["meta"], [_row(summary) for summary in content["summaries"]], []
    applied = {row.controller for row in rows}
    for failure in content["failures"]:
        scenario, controller, reason = failure["scenario"], failure["controller"], failure["failure"]
        verb, _, why = reason.partition(": ")
        if verb != "does not apply":
            raise ValueError(f"{scenario}, {controller}: {reason}; run dcgrid benchmark again without it")
        if controller in applied:
            refusals.append(Refusal(scenario, controller, why))
    unused = tuple(dict.fromkeys(f["controller"] for f in content["failures"] if f["controller"] not in applied))
    scenarios = {preset: _facts(preset, digest, meta["episodes"]) for preset, digest in meta["scenarios"].items()}
    command = public_command(meta["command"], name)
    return BenchmarkData(command, meta["versions"], scenarios, unused, tuple(refusals), tuple(rows))


def _row(summary: Mapping[str, Any]) -> Row:
    scenario, controller = summary["scenario"], summary["controller"]
    if summary["score"] is None:
        raise ValueError(f"{scenario}, {controller}: score is null; publish runs with a score for every controller")
    means = summary["means"] | {"interquartile_mean": summary["interquartile_mean"]}
    score, saved = (Estimate(**summary[name]) for name in ESTIMATES)
    return Row(scenario, controller, summary["observes"], score, saved, {name: means[name] for name in FIGURES})


def _facts(preset: str, digest: str, episodes: int) -> Facts:
    if preset not in PRESETS:
        raise ValueError(f"scenario is {preset!r}; publish presets only")
    scenario = make_scenario(preset, split=SPLIT)
    if (now := scenario_hash(scenario)) != digest:
        raise ValueError(f"{preset}: its hash is {digest}, now {now}; run dcgrid benchmark again")
    costs = published(scenario)
    assert costs is not None, preset
    costs = costs.select(range(episodes))
    costs.check_episodes(scenario, episodes)
    return Facts(episodes, hindsight_costs(costs), digest)


def public_command(command: str, name: str) -> str:
    """The command of a run without the number of processes, and with the folder that bears the page's name."""
    return re.sub(r" --(workers|out)[ =]('[^']*'|\S+)", "", command) + f" --out results/{name}"


def all_data(folder: Path = FOLDER) -> dict[str, BenchmarkData]:
    """All data files, by the name of their page."""
    return {path.stem: BenchmarkData.load(path) for path in sorted(folder.glob("*.json"))}


@dataclass(frozen=True)
class PublishBenchmark(Command):
    """Write the data file of a benchmark's page.

    The source is results.json of a run of dcgrid benchmark.
    """

    results: tyro.conf.Positional[Path]
    """File results.json of dcgrid benchmark."""
    out: Path = Path("docs/benchmarks/benchmark.json")
    """Data file, named after its page."""

    def run(self) -> None:
        """Read, check, write. ValueError for a run that cannot be published, before anything is written."""
        try:
            data = from_results(json.loads(self.results.read_text(encoding="utf-8")), self.out.stem)
        except ValueError as error:
            raise ValueError(f"{self.results}: {error}") from None
        data.save(self.out)
        say(plain_console(), f"wrote {self.out}: {_count(data.rows, 'row')}, {_count(data.scenarios, 'scenario')}")


def _count(things: Sequence[Any] | Mapping[str, Any], word: str) -> str:
    return f"{len(things)} {word}{'s' * (len(things) != 1)}"
