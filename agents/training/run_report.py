"""Report of a training, or of the trainings of several seeds: one HTML page without external resources.

The page has the validation costs next to those of the baseline, the learning curve, links to the replays, the
configuration, and the command and versions to reproduce the policy.
"""

from __future__ import annotations

import dataclasses
import html
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, ScalarFormatter

from dcgrid_env import METRICS, Scenario, scenario_hash
from dcgrid_env.agents.policy.card import Card
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.training.best_replay import REPLAY
from dcgrid_env.agents.training.config import FREE, Training
from dcgrid_env.agents.training.curves import COLOURS
from dcgrid_env.agents.training.run_folder import read_curve
from dcgrid_env.agents.training.variants import scenarios
from dcgrid_env.baselines import make_controller, published
from dcgrid_env.baselines.evaluation import Evaluation, evaluate
from dcgrid_env.baselines.hindsight_costs import FOLDER
from dcgrid_env.baselines.score import REFERENCE, Estimate, mean_over_seeds, saved, saved_pct, score_error
from dcgrid_env.core.figure_axes import REFERENCE_COLOUR, label_axes, new_figure
from dcgrid_env.core.files import write_text
from dcgrid_env.core.html_page import image, page, png
from dcgrid_env.core.text_table import NONE, Table
from dcgrid_env.core.versions import PACKAGES, versions

REPORT = "report.html"
"""Name of the page in the folder of a training run."""
LAW_COLUMN = "J_law"
"""Column of the baseline's cost in the learning curve of ``carry-over``; other algorithms have ``J_droop``."""
_TORCH = ("torch", "stable-baselines3")
_LOG_FROM = 5.0
"""Ratio of the largest to the least cost from which their axis is logarithmic."""
_STYLE = """
body { max-width: 860px } td { white-space: nowrap }
.text td, .text th { white-space: normal; text-align: left } .hashes td { overflow-wrap: anywhere }
"""


class _Run(NamedTuple):
    """A completed training."""

    config: Training
    card: Card
    curve: Sequence[Mapping[str, float]]
    """Rows of its curve with a validation."""


def write_report(configs: Sequence[Training], path: Path) -> None:
    """Write the report of completed trainings, which differ only in the seed.

    The policies run the validation episodes again. The baseline is the tuned droop; for ``carry-over``, whose
    validation differs, it is the law, with the figures of the curve.

    Parameters
    ----------
    configs
        Configurations of the trainings, one or more.
    path
        HTML file to write.
    """
    runs = [_read(config) for config in configs]
    first = runs[0].config
    validated = _validated(runs)
    seeds = f"seed {first.seed}" if len(runs) == 1 else f"{len(runs)} seeds"
    title = f"{first.algorithm()} on {first.scenario}, {seeds}"
    figure, text = png(_curves(runs), dpi=130), "Learning curve: mean J on the validation episodes"
    body = [
        "<h2>Validation</h2>",
        *(table.html() for table in _costs(runs, validated)),
        "<h2>Learning curve</h2>",
        f"<p>{image(figure, text)}</p>",
        *_replays([run.config.folder for run in runs], path),
        "<h2>Configuration</h2>",
        f"<div class=text>{_settings(runs).html()}</div>",
        "<h2>How to reproduce</h2>",
        *(f"<pre>{html.escape(run.card.command)}</pre>" for run in runs),
        f'<div class="text hashes">{_origin(runs, validated).html()}</div>',
    ]
    write_text(path, page(title, "\n".join(body), _STYLE))


def _read(config: Training) -> _Run:
    rows = [row for row in read_curve(config.folder) if np.isfinite(row["J"])]
    return _Run(config, Card.load(config.folder / "policy.json"), rows)


class _OnScenario(NamedTuple):
    """The validation episodes of a scenario."""

    scenario: Scenario
    policies: Sequence[Evaluation]
    """One for each run."""
    droop: Evaluation


def _validated(runs: Sequence[_Run]) -> list[_OnScenario]:
    """Run the validation episodes; empty for ``carry-over``."""
    first = runs[0].config
    if LAW_COLUMN in runs[0].curve[0]:
        return []
    seeds, found = range(first.validation_episodes), []
    policies = [Policy.load(run.config.folder / "policy.safetensors") for run in runs]
    for scenario in scenarios(first.scenario, first.set, "validation"):
        droop = evaluate(make_controller(REFERENCE, scenario), scenario, seeds)
        found.append(_OnScenario(scenario, [evaluate(policy, scenario, seeds) for policy in policies], droop))
    return found


def _costs(runs: Sequence[_Run], validated: Sequence[_OnScenario]) -> list[Table]:
    """The table of costs of each scenario."""
    if not validated:
        return [_by_law(runs)]
    return [_on_scenario(runs, one) for one in validated]


def _by_law(runs: Sequence[_Run]) -> Table:
    rows = []
    for run in runs:
        best = min(run.curve, key=lambda row: row["J"])
        share = 100.0 * (1.0 - best["J"] / best[LAW_COLUMN])
        cells = (f"{best['J']:.4f}", f"{best[LAW_COLUMN]:.4f}", f"{share:.2f}", f"{run.card.training_s or 0.0:.0f}")
        rows.append((f"seed {run.config.seed}", *cells))
    header = ("policy", "J", "J of the law", "J saved, %", "training, s")
    note = "Mean over the episodes of the held-out feeders by which the policy was selected."
    return Table("", header, tuple(rows), (note,))


def _on_scenario(runs: Sequence[_Run], one: _OnScenario) -> Table:
    n, delay = len(one.droop.seeds), METRICS["delay_mean_s"]
    hindsight = published(one.scenario, FOLDER)
    best = (
        None if n < 2 or hindsight is None or hindsight.missing(one.droop.seeds) else hindsight.select(one.droop.seeds)
    )
    rows, scores = [], []
    for run, evaluation in zip(runs, one.policies, strict=True):
        saving = f"{saved_pct(evaluation.J, one.droop.J):.2f}"
        if n > 1:
            saving = _interval(saved(evaluation.J, one.droop.J), 2)
        row = [f"seed {run.config.seed}", f"{evaluation.means['J']:.4f}", saving]
        if best is not None:
            scores.append(evaluation.score(one.droop, best).score)
            row.append(_interval(scores[-1], 3))
        rows.append((*row, delay.text(evaluation.means[delay.name]), f"{run.card.training_s or 0.0:.0f}"))
    if len(runs) > 1:
        rows.append(_mean_row(one, scores, best, n))
    droop = (f"{one.droop.means['J']:.4f}", "0", *(("0",) if best is not None else ()))
    rows.append((REFERENCE, *droop, delay.text(one.droop.means[delay.name]), ""))
    header = ("policy", "J", "J saved, %", *(("score",) if best is not None else ()), "delay, s", "training, s")
    notes = [
        f"{n} validation episodes of {one.scenario.name}. Policies are selected on these episodes, so the figures are "
        "optimistic; dcgrid evaluate scores on the test split. In parentheses: 95 % intervals over episodes, and for "
        "the mean over seeds and episodes."
    ]
    if best is None:
        notes.append(
            "No score: hindsight costs of these episodes are not stored; dcgrid hindsight --split validation solves "
            "them."
        )
    return Table(one.scenario.name, header, tuple(rows), tuple(notes))


def _mean_row(one: _OnScenario, scores: Sequence[Estimate], best: Any, n: int) -> tuple[str, ...]:
    """The row of the mean over seeds."""
    delay, droop = METRICS["delay_mean_s"], one.droop.J
    every = [float(saved_pct(evaluation.J, droop)) for evaluation in one.policies]
    mean_j = np.mean([evaluation.J for evaluation in one.policies], axis=0)
    row = ["mean", f"{mean_j.mean():.4f}"]
    if n > 1:
        # The saving is 100 times a score whose best cost is zero.
        row.append(_interval(mean_over_seeds(every, 100.0 * score_error(mean_j, droop, np.zeros(n)), n), 2))
    else:
        row.append(f"{np.mean(every):.2f}")
    if best is not None:
        error = score_error(mean_j, droop, best.J)
        row.append(_interval(mean_over_seeds([score.value for score in scores], error, n), 3))
    delay_s = float(np.mean([evaluation.means[delay.name] for evaluation in one.policies]))
    return (*row, delay.text(delay_s), "")


def _interval(estimate: Estimate, digits: int) -> str:
    return f"{estimate.value:.{digits}f} ({estimate.low:.{digits}f} .. {estimate.high:.{digits}f})"


def _curves(runs: Sequence[_Run]) -> Figure:
    """J of each validation over the steps of environments, a line for each seed, and that of the baseline."""
    figure = new_figure(5.4, 3.4)
    ax = figure.subplots()
    column = LAW_COLUMN if LAW_COLUMN in runs[0].curve[0] else "J_droop"
    reference = runs[0].curve[-1][column]
    costs = [reference]
    for i, run in enumerate(runs):
        steps, j = ([row[name] for row in run.curve] for name in ("env_steps", "J"))
        label = f"seed {run.config.seed}" if len(runs) <= len(COLOURS) else None
        ax.plot(steps, j, color=COLOURS[i % len(COLOURS)], marker=".", linewidth=1.4, markersize=4, label=label)
        costs += j
    name = "law" if column == LAW_COLUMN else REFERENCE
    ax.axhline(reference, color=REFERENCE_COLOUR, linestyle="--", linewidth=1.4, label=f"{name}, {reference:.4f}")
    label_axes(ax, "steps of environments", "mean J on validation")
    if max(costs) > _LOG_FROM * min(costs) > 0.0:
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter(ScalarFormatter())
        ax.yaxis.set_minor_formatter(NullFormatter())
    ax.legend(fontsize=9, frameon=False)
    return figure


def _replays(folders: Sequence[Path], path: Path) -> list[str]:
    """Links to the replays that exist."""
    links = []
    for folder in folders:
        if (folder / REPLAY).is_file():
            where = quote(Path(os.path.relpath(folder / REPLAY, path.parent)).as_posix())
            links.append(f'<a href="{where}">{html.escape(folder.name)}</a>')
    text = "The first validation episode under the best policy, next to the baseline, step by step: "
    none = "The trainings wrote no replay (--no-replay, or the extra replay was not installed)."
    return ["<h2>Replay</h2>", f"<p>{text}{', '.join(links)}</p>" if links else f"<p>{none}</p>"]


def _settings(runs: Sequence[_Run]) -> Table:
    """All options, with the default of the algorithm where it differs."""
    config, plain = runs[0].config, type(runs[0].config)()
    rows = []
    for field in dataclasses.fields(config):
        if field.name in FREE:
            continue
        values = list(dict.fromkeys(_shown(getattr(run.config, field.name)) for run in runs))
        default = _shown(getattr(plain, field.name))
        rows.append((f"--{field.name.replace('_', '-')}", ", ".join(values), "" if values == [default] else default))
    return Table("", ("option", "value", "default, if different"), tuple(rows))


def _shown(value: object) -> str:
    if isinstance(value, tuple):
        return " ".join(map(_shown, value)) or NONE
    return f"{value:g}" if isinstance(value, float) else NONE if value is None else str(value)


def _origin(runs: Sequence[_Run], validated: Sequence[_OnScenario]) -> Table:
    """Versions, hashes and folders."""
    installed = versions((*PACKAGES, *_TORCH))
    rows = [(name, text) for name, text in installed.items() if text]
    rows += [(f"hash of {one.scenario.name}, validation split", scenario_hash(one.scenario)) for one in validated]
    rows += [(f"SHA-256 of the policy of seed {run.config.seed}", run.card.sha256) for run in runs]
    return Table("", ("what", "value"), tuple(rows))
