"""What a policy loses without this or that, and what it is worth on a scenario that it was not trained on."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dcgrid_env import METRICS
from dcgrid_env.agents import Policy
from dcgrid_env.agents.studies.learning_tables import (
    HEADINGS,
    NONE,
    SCORE,
    Table,
    commands,
    estimate,
    figures,
    page,
    spread,
    wrapped,
)
from dcgrid_env.agents.studies.scored import Scored, droop_on_test, score, scored
from dcgrid_env.agents.studies.training_runs import command, folder, trained
from dcgrid_env.baselines.rollout import ControllerError
from dcgrid_env.baselines.score import REFERENCE

VARIANTS: dict[str, dict[str, Any]] = {
    "all: both axes, local, preview": {},
    "clock only": {"act": "clock"},
    "reactive power only": {"act": "q"},
    "sees its neighbours too": {"observe": "neighbours"},
    "sees all voltages": {"observe": "feeder"},
    "one network that sees and moves all": {"view": "centralised"},
    "without preview": {"preview": False},
}
"""What differs from the algorithm's defaults."""
SAFE = "monotone, gain below the stability bound (safe)"
"""The variant that is another algorithm, whose networks also see less."""


@dataclass(frozen=True)
class Variant:
    """A variant's policies, one for each training seed."""

    label: str
    tested: Scored | None
    failure: str
    """Why there is none."""
    command: str
    """Command of the first seed's training."""
    training_s: float
    """Mean over the seeds."""


def configs(algorithms: Mapping[str, type[Any]], scenario: str, chosen: dict[str, Any], seeds: int,
            runs: Path) -> dict[str, list[Any]]:  # fmt: skip
    """The runs of each variant; ``algorithms`` holds the configuration of ``analytic``, and of ``safe`` if there is."""
    settings = {label: (algorithms["analytic"], own) for label, own in VARIANTS.items()}
    if "safe" in algorithms:
        settings[SAFE] = (algorithms["safe"], {})
    results: dict[str, list[Any]] = {}
    for label, (algorithm, own) in settings.items():
        short = "-".join(str(part).lower() for pair in own.items() for part in pair)
        for seed in range(seeds):
            one = algorithm(scenario=scenario, seed=seed, **own, **chosen)
            name = short or algorithm.__name__.lower()
            placed = dataclasses.replace(one, out=folder(runs, scenario, name, one.updates, seed))
            results.setdefault(label, []).append(placed)
    return results


def ablation(
    scenario: str, episodes: int, runs: Mapping[str, Sequence[Any]], failures: Mapping[Path, str]
) -> list[Variant]:
    """Test the policies of finished runs; ``failures`` holds the folders of those that are none."""
    results = []
    for label, every in runs.items():
        failure = next((failures[one.out] for one in every if one.out in failures), "")
        if failure:
            results.append(Variant(label, None, failure, command(every[0]), 0.0))
            continue
        pairs = [trained(one) for one in every]
        spent_s = sum(card.training_s or 0.0 for _, card in pairs) / len(pairs)
        tested = scored([policy for policy, _ in pairs], scenario, episodes)
        results.append(Variant(label, tested, "", command(every[0]), spent_s))
    return results


def ablation_table(scenario: str, episodes: int, variants: Sequence[Variant]) -> Table:
    """Scores of the variants, delay beside."""
    droop = droop_on_test(scenario, episodes)
    header = ("variant", "score", "lowest and highest seed", *HEADINGS, "training, s")
    rows = []
    for one in variants:
        if one.tested is None:
            rows.append((one.label, "failed", *[NONE] * (len(header) - 2)))
            continue
        scores = estimate(one.tested.score(droop)), spread(one.tested.spread(droop))
        rows.append((one.label, *scores, *figures(one.tested.mean.means), f"{one.training_s:.0f}"))
    rows.append((REFERENCE, estimate(score(droop, droop)), NONE, *figures(droop.means), NONE))
    n = max((len(one.tested.each) for one in variants if one.tested), default=0)
    title = f"{scenario}: {episodes} test episodes, means over episodes and {n} training seed{'s' * (n > 1)}"
    notes = tuple(f"{one.label}: {one.failure}" for one in variants if one.failure)
    return Table(title, header, tuple(rows), notes)


def transfer_table(policies: Mapping[str, Policy], scenarios: Sequence[str], episodes: int) -> Table:
    """Scores of policies (rows) on scenarios (columns), whether they were trained there or not."""
    rows = []
    for name, policy in policies.items():
        cells = (_cell(policy, scenario, episodes) for scenario in scenarios)
        where = "" if name.startswith(f"{policy.trained_on}-") else f" (on {policy.trained_on})"
        rows.append((name + where, *cells))
    title = f"Trained on one scenario (rows), tested on another (columns): score, {episodes} test episodes"
    notes = (
        "In brackets those that it was trained on; * work waits longer than under the tuned droop there; – the "
        "policy's widths do not fit: its agents see or do something else there.",
    )
    return Table(title, ("policy", *scenarios), tuple(rows), notes)


def _cell(policy: Policy, scenario: str, episodes: int) -> str:
    droop = droop_on_test(scenario, episodes)
    try:
        results = scored([policy], scenario, episodes)
    except ControllerError as error:
        if error.refuses is None:
            raise
        return NONE
    value = results.score(droop)
    waits = METRICS["delay_mean_s"].is_worse(results.mean.means, droop.means)
    text = ("no score" if value is None else f"{value.value:.2f}") + "*" * waits
    return f"[{text}]" if scenario in map(str.strip, policy.trained_on.split(",")) else text


def markdown(ablated: Table, variants: Sequence[Variant], transferred: Table | None, made_by: str) -> str:
    """The page."""
    about = (
        "Each variant is trained anew by the same steps; what is not named is as in the first row, but safe also sees "
        "less. Nothing was selected on the test split. " + SCORE
    )
    each = commands("Each run of the first seed by itself:", ((one.label, one.command) for one in variants))
    return page("Ablations", made_by, wrapped(about), ablated.markdown(), each,
                transferred.markdown() if transferred else "")  # fmt: skip
