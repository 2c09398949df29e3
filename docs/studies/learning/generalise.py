"""Train a policy on all scenarios but one and test it on the scenario that was left out."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dcgrid_env import make_scenario
from dcgrid_env.agents.policy.policy import SHIPPED
from dcgrid_env.agents.train_command import ALGORITHMS
from dcgrid_env.agents.training.training_runs import command
from dcgrid_env.baselines.scenario_names import scenario_names
from dcgrid_env.baselines.score import static_rules
from dcgrid_env.core.commands.settings import check_folder
from dcgrid_env.core.commands.terminal import plain_console, say, working
from dcgrid_env.core.files import write_text
from dcgrid_env.core.versions import meta
from docs.studies.learning.learning_tables import NONE, SCORE, Table, brief, commands, estimate, page, spread, wrapped
from docs.studies.learning.scored import Scored, controller_on_test, droop_on_test, score, scored
from docs.studies.learning.trainings import Study, do_trainings, folder, trained


@dataclass(frozen=True)
class LeftOut:
    """Policies that never saw a scenario, one for each training seed."""

    scenario: str
    trained_on: str
    tested: Scored | None
    failure: str
    """Why there is none."""
    command: str
    """Command of the first seed's training."""


def configs(algorithm: type[Any], scenarios: Sequence[str], chosen: dict[str, Any], seeds: int,
            runs: Path) -> dict[str, list[Any]]:  # fmt: skip
    """The runs for each scenario left out."""
    results: dict[str, list[Any]] = {}
    for left_out in scenarios:
        feeder = make_scenario(left_out).feeder.name
        others = ",".join(name for name in scenarios if make_scenario(name).feeder.name != feeder)
        if not others:
            raise ValueError(f"scenarios: all are on {left_out}'s feeder; name some on others")
        for seed in range(seeds):
            one = algorithm(scenario=others, seed=seed, **chosen)
            place = folder(
                runs, f"without-{left_out}", f"{others.replace(',', '+')}-vary-{one.vary}", one.updates, seed
            )
            results.setdefault(left_out, []).append(dataclasses.replace(one, out=place))
    return results


def generalise(episodes: int, runs: Mapping[str, Sequence[Any]], failures: Mapping[Path, str]) -> list[LeftOut]:
    """Test the policies of finished runs on the scenario left out; ``failures`` has the folders of failed runs."""
    results = []
    for scenario, every in runs.items():
        failure = next((failures[one.out] for one in every if one.out in failures), "")
        tested = None if failure else scored([trained(one)[0] for one in every], scenario, episodes)
        results.append(LeftOut(scenario, every[0].scenario, tested, failure, command(every[0])))
    return results


def table(episodes: int, results: Sequence[LeftOut]) -> Table:
    """A row for each scenario left out, with the policy and rules that were trained or tuned for it."""
    header = ("left out", "trained on", "score there", "lowest and highest seed", "trained there", "best static rule",
              "J", "J: droop-tuned", "mean delay, s", "droop-tuned, s")  # fmt: skip
    rows = []
    for one in results:
        droop = droop_on_test(one.scenario, episodes)
        rules = static_rules(make_scenario(one.scenario))
        static = [score(controller_on_test(name, one.scenario, episodes).mean, droop) for name in rules]
        best = max((value for value in static if value), default=None, key=lambda value: value.value)
        own = f"{one.scenario}-analytic"
        there = score(controller_on_test(own, one.scenario, episodes).mean, droop) if own in SHIPPED else None
        rows.append((
            one.scenario,
            one.trained_on.replace(",", ", "),
            "failed" if one.tested is None else estimate(one.tested.score(droop)),
            NONE if one.tested is None else spread(one.tested.spread(droop)),
            NONE if there is None else f"{there.value:.3f}",
            NONE if best is None else f"{best.value:.3f}",
            NONE if one.tested is None else f"{one.tested.mean.means['J']:.4f}",
            f"{droop.means['J']:.4f}",
            NONE if one.tested is None else f"{one.tested.mean.means['delay_mean_s']:.2f}",
            f"{droop.means['delay_mean_s']:.2f}",
        ))  # fmt: skip
    n = max((len(one.tested.each) for one in results if one.tested), default=0)
    title = f"{episodes} test episodes of the scenario left out, {n} training seed{'s' * (n > 1)}"
    return Table(title, header, tuple(rows), tuple(f"{one.scenario}: {one.failure}" for one in results if one.failure))


def markdown(results: Sequence[LeftOut], shown: Table, made_by: str) -> str:
    """The page."""
    about = (
        "For each scenario, a policy is trained on all scenarios with another feeder and on variants of them with "
        "other places, ratings and substation voltages. It is selected on their validation splits and then tested, "
        "unchanged, on the scenario that was left out. It has local observations, which include R and X of the bus. "
        "The table compares it with the bundled policy for that scenario and with the better of the two rules that "
        "measure nothing. " + SCORE
    )
    each = commands(
        "Commands for the first seed of each run:", ((f"without {one.scenario}", one.command) for one in results)
    )
    return page("A feeder that was never seen", made_by, wrapped(about), shown.markdown(), each)


@dataclass(frozen=True)
class Generalise(Study):
    """Train on all scenarios but one and score on that one.

    Training runs are kept in RUNS: an interrupted command continues where it stopped.
    """

    scenarios: str = "ieee33,das69,khodr141,ieee123"
    """Names of scenarios, at least two, separated by commas (dcgrid list)."""
    vary: int = 6
    """Variants of each scenario to train on: other places, ratings and substation voltages."""
    runs: Path = Path("results/generalise")
    """Folder of the training runs."""
    out: Path = Path("results/generalise")
    """Folder for generalise.md."""

    def run(self) -> None:
        """Train, test, write. ValueError for an invalid setting, before anything is trained."""
        scenarios = scenario_names(self.scenarios)
        if len(scenarios) < 2:
            raise ValueError(f"scenarios is {self.scenarios!r}; give at least two, one is left out")
        if self.vary < 0:
            raise ValueError(f"vary is {self.vary}; give at least 0")
        chosen = self.settings(vary=self.vary)
        runs = configs(ALGORITHMS["analytic"].configuration(), scenarios, chosen, self.seeds, self.runs)
        check_folder(self.out)
        console = plain_console()
        failures = do_trainings((config for every in runs.values() for config in every), self.place, console)
        with working(console, f"{self.episodes} test episodes of each scenario"):
            results = generalise(self.episodes, runs, failures)
            scores = table(self.episodes, results)
        console.print(
            brief(scores, "score there", "trained there", "best static rule", "mean delay, s").rich(console.width)
        )
        write_text(self.out / "generalise.md", markdown(results, scores, meta()["command"]))
        say(console, f"wrote {self.out / 'generalise.md'}")
