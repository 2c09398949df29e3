"""Ablations of a policy, and its scores on scenarios that it was not trained on."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dcgrid_env import METRICS
from dcgrid_env.agents import Policy
from dcgrid_env.agents.policy.policy import SHIPPED
from dcgrid_env.agents.train_command import ALGORITHMS
from dcgrid_env.agents.training.training_runs import command
from dcgrid_env.baselines.rollout import ControllerError
from dcgrid_env.baselines.scenario_names import one_scenario, scenario_names
from dcgrid_env.baselines.score import REFERENCE
from dcgrid_env.core.commands.names import split_names
from dcgrid_env.core.commands.settings import check_folder
from dcgrid_env.core.commands.terminal import plain_console, say, working
from dcgrid_env.core.files import write_text
from dcgrid_env.core.versions import meta
from docs.studies.learning.learning_tables import (
    HEADINGS,
    NONE,
    SCORE,
    Table,
    brief,
    commands,
    estimate,
    figures,
    page,
    spread,
    wrapped,
)
from docs.studies.learning.scored import Scored, droop_on_test, score, scored
from docs.studies.learning.trainings import Study, do_trainings, folder, trained

VARIANTS: dict[str, dict[str, Any]] = {
    "all: both axes, local, preview": {},
    "clock only": {"act": "clock"},
    "reactive power only": {"act": "q"},
    "sees its neighbours too": {"observe": "neighbours"},
    "sees all voltages": {"observe": "feeder"},
    "one network that sees and moves all": {"view": "centralised"},
    "without preview": {"preview": False},
}
"""Settings of each variant that differ from the algorithm's defaults."""
SAFE = "monotone, gain below the stability bound (safe)"
"""The variant that is another algorithm, whose networks also see less."""


@dataclass(frozen=True)
class Variant:
    """A variant's policies, one for each training seed."""

    label: str
    tested: Scored | None
    failure: str
    """Reason why the variant has no policies; empty if it has some."""
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
    """Return the table of scores and delays of the variants."""
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


@dataclass(frozen=True)
class Ablate(Study):
    """Train a policy without some of its parts and score each.

    Also scores trained policies on other scenarios than their own.

    Trainings are kept in RUNS: an interrupted command goes on where it was, and what is done is not done again.
    """

    scenario: str = "ieee33-weak"
    """Name of a scenario (dcgrid list)."""
    policies: str = "analytic"
    """Policies to test on other scenarios: analytic for all of that name that ship, or names and files, separated by
    commas; or none. Those that are one network for all agents are left out."""
    transfer: str = "all"
    """Scenarios to test them on, separated by commas, or all."""
    runs: Path = Path("results/ablate")
    """Folder of the training runs."""
    out: Path = Path("results/ablate")
    """Folder for ablations.md."""

    def run(self) -> None:
        """Train, test, write. ValueError for an invalid setting, before anything is trained."""
        scenario = one_scenario(self.scenario)
        policies, others = _policies(self.policies), scenario_names(self.transfer)
        chosen = self.settings()
        algorithms = {name: ALGORITHMS[name].configuration() for name in ("analytic", "safe")}
        runs = configs(algorithms, scenario, chosen, self.seeds, self.runs)
        check_folder(self.out)
        console = plain_console()
        failures = do_trainings((config for every in runs.values() for config in every), self.place, console)
        with working(console, f"{self.episodes} test episodes of {scenario}"):
            results = ablation(scenario, self.episodes, runs, failures)
            ablated = ablation_table(scenario, self.episodes, results)
        console.print(brief(ablated, "score", "J", "mean delay, s", "training, s").rich(console.width))
        transferred = None
        if policies:
            with working(console, f"{len(policies)} policies on {len(others)} scenarios"):
                transferred = transfer_table(policies, others, self.episodes)
            console.print(transferred.rich(console.width))
        write_text(self.out / "ablations.md", markdown(ablated, results, transferred, meta()["command"]))
        say(console, f"wrote {self.out / 'ablations.md'}")


def _policies(asked: str) -> dict[str, Policy]:
    """Policies for every number of agents, by name; PolicyError for what is none."""
    names = []
    for name in split_names(asked):
        chosen = [policy for policy in SHIPPED if policy.endswith("-analytic")] if name == "analytic" else [name]
        names += [] if name == "none" else chosen
    policies = {name: Policy.load(name) for name in names}
    return {name: policy for name, policy in policies.items() if policy.kind == "shared"}
