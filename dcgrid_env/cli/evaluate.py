"""The command ``dcgrid evaluate``."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from dcgrid_env.cli.command import GOES_ON
from dcgrid_env.cli.hindsight import kept_episodes, solve_missing
from dcgrid_env.cli.opening import offer
from dcgrid_env.cli.runs import draw_first
from dcgrid_env.cli.sb3_export import SUFFIX as SB3
from dcgrid_env.cli.sb3_export import require_trusted
from dcgrid_env.cli.settings import Overrides, check_folder, tuned_from
from dcgrid_env.cli.terminal import plain_console, say
from dcgrid_env.cli.workers import OverWorkers
from dcgrid_env.core.install import from_clone

if TYPE_CHECKING:
    from rich.console import Console

    from dcgrid_env import Scenario
    from dcgrid_env.agents import Evaluation
    from dcgrid_env.baselines import Controller, Published
    from dcgrid_env.baselines.benchmark.benchmark_tables import Table
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec
    from dcgrid_env.baselines.score import Score
    from dcgrid_env.core.work.unit import Place


@dataclass(frozen=True)
class Evaluate(OverWorkers):
    """Score a policy on held-out episodes.

    Compares it with the tuned droop law and the best rules that measure nothing.
    """

    policy: tyro.conf.Positional[str]
    """A policy that ships or a controller (dcgrid list), a training run's folder, a policy's file, or a class of your
    own (module:Class, file.py:Class, in quotes with arguments: 'file.py:Class(gain=0.5)'); with --trust a model of
    Stable-Baselines3 too (model.zip). Before a policy guarded: may stand, which keeps it near the tuned droop where it
    was not trained to act."""
    scenario: str | None = None
    """Name of a scenario, path/to/file.toml, or path/to/file.py:function or package.module:function that
    makes your own; the one that the policy was trained on unless given."""
    set: Overrides = ()
    """Fields of the scenario that are to be otherwise, for instance --set horizon=60 sensing.noise_pu=0.005."""
    split: str = "test"
    """Which episodes the seeds mean: train, validation, test or ood."""
    episodes: int = 100
    """Number of episodes: those of seeds seed, seed + 1, ..."""
    seed: int = 0
    """Seed of the first episode."""
    hindsight: bool = False
    """Whether to solve the episodes whose hindsight, which a score needs, neither ships nor stands in
    results/hindsight; they are kept there. Without it the command says how long that would take."""
    tuned: Path | None = None
    """File of dcgrid tune that the gains of tuned controllers must come from. Without it they are those of
    results/tuned.json where they were found for this very scenario, else those that ship with the preset."""
    trust: bool = False
    """Whether to load a zip of Stable-Baselines3, which is pickle and so runs whatever code it holds (dcgrid export-sb3
    converts one without), and to run the code that a training run's folder names as its scenario."""
    out: Path = Path("results/evaluate")
    """Folder for figure.png, the first episode under the policy and the tuned droop law; made if it is not there."""
    open: bool = False
    """Open the figure at the end."""

    @property
    def resumes(self) -> str:
        """How to go on: what has been kept is not done again."""
        return GOES_ON if self.hindsight else ""

    def run(self) -> None:
        """Run, print the table and what it says. ValueError for an invalid setting."""
        from dcgrid_env.agents import evaluate, find_controller
        from dcgrid_env.baselines import published
        from dcgrid_env.baselines.benchmark.benchmark_tables import headroom_lines
        from dcgrid_env.baselines.hindsight_costs import FOLDER
        from dcgrid_env.baselines.score import REFERENCE, STATIC
        from dcgrid_env.baselines.tuning.tuned import require_tuned

        for field, least in (("episodes", 1), ("seed", 0)):
            if getattr(self, field) < least:
                raise ValueError(f"{field} is {getattr(self, field)}; give at least {least}")
        require_tuned(self.tuned)
        place, zipped = self.place, _zipped(self.policy)
        if zipped is not None:
            require_trusted(zipped, self.trust, self.scenario or "SCENARIO")
        check_folder(self.out)
        spec = _scenario_of(self)
        scenario = spec.make(self.split)
        seeds = range(self.seed, self.seed + self.episodes)
        if self.hindsight:
            kept_episodes(FOLDER, scenario)  # ValueError for a file of another scenario, before anything is run
        controller = find_controller(self.policy, scenario, self.tuned) if zipped is None else _sb3(zipped)
        controllers = {self.policy: controller}
        left_out = []
        for name in (REFERENCE, *STATIC):
            try:
                controllers.setdefault(name, find_controller(name, scenario, self.tuned))
            except ValueError as error:
                left_out.append(f"{name} is left out: {error}")
        console = plain_console()
        evaluations = {}
        with console.status(f"{self.episodes} episodes"):
            for name, controller in controllers.items():
                evaluations[name] = evaluate(controller, scenario, seeds, name)
        scores, why = _scores(evaluations, self, spec, place, console)
        about = f"{self.episodes} episodes" + f", seeds from {self.seed}" * (self.seed > 0)
        console.print(table(evaluations, scores, f"{scenario.name}, {self.split} split, {about}").rich(console.width))
        said = [*([why] if why else []), *left_out, *remarks(self.policy, evaluations)]
        if scores and (costs := published(scenario, FOLDER)):
            said += headroom_lines(costs.of(seeds), evaluations[REFERENCE].J)
        for line in [*said, *tuned_from(list(controllers), scenario, self.tuned)]:
            console.print(line)
        shown = {name: controllers[name] for name in (self.policy, REFERENCE) if name in controllers}
        figure = draw_first(scenario, self.seed, shown, self.out, console)
        say(console, f"wrote {figure}")
        offer(console, figure, self.open)


def _zipped(policy: str) -> Path | None:
    """The zip of Stable-Baselines3 that is named, maybe by its folder; None for anything else."""
    from dcgrid_env.baselines.registry import controller_file, split_prefix

    before, inner = split_prefix(policy)
    file = None if before else controller_file(inner)  # no guard stands before a zip
    return file if file is not None and file.suffix == SB3 else None


def _sb3(file: Path) -> Controller:
    """The model of a trusted zip; ValueError where it cannot be loaded or needs what stands beside it."""
    try:
        from dcgrid_env.agents.from_sb3.sb3_controller import trusted
    except ImportError as error:
        raise ValueError(f"policy {str(file)!r} needs {error.name}; {from_clone('agents')}") from None
    return trusted(file)


def _scenario_of(cfg: Evaluate) -> ScenarioSpec:
    """What is asked for, or else what the policy was trained on; ValueError where that is not known."""
    from dcgrid_env import PRESETS
    from dcgrid_env.agents.policy.policy import SHIPPED, SUFFIX, Policy
    from dcgrid_env.baselines.registry import controller_file, require_known, split_prefix
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec

    if cfg.scenario is not None:
        return ScenarioSpec(cfg.scenario, cfg.set)
    _, inner = split_prefix(cfg.policy)
    file = controller_file(inner)
    if file is not None and Path(inner).is_dir():
        where, overrides = _of_training(Path(inner) / "config.json", cfg.trust)
        if where and "," not in where:
            return ScenarioSpec(where, (*overrides, *cfg.set))
    if inner in SHIPPED:
        where = Policy.load(inner).trained_on
    else:
        where = Policy.load(file).trained_on if file is not None and file.suffix == SUFFIX else ""
    if where not in PRESETS:
        require_known(inner)
        raise ValueError(f"policy {inner!r} is of no preset of its own; say on which --scenario (dcgrid list)")
    return ScenarioSpec(where, cfg.set)


def _of_training(config: Path, trust: bool) -> tuple[str, tuple[str, ...]]:
    """Scenario and overrides of a training run, empty where there is no such file; ValueError for what cannot be used.

    A scenario that is code is refused unless it is trusted: a folder must not run what somebody else wrote into it.
    """
    from dcgrid_env.baselines.user_code import parse

    if not config.is_file():
        return "", ()
    try:
        trained = json.loads(config.read_text(encoding="utf-8"))
        where, overrides = trained.get("scenario", ""), tuple(trained.get("set", ()))
        if not all(isinstance(word, str) for word in (where, *overrides)):
            raise TypeError("scenario and set are no texts")
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(
            f"{config} is none of dcgrid train ({type(error).__name__}: {error}); give --scenario and the policy's file"
        ) from None
    if where and parse(where) is not None and not trust:
        raise ValueError(
            f"{config} names code, scenario {where!r}, which would run; name it yourself with --scenario, or add "
            "--trust if you trust who made the folder"
        )
    return where, overrides


def _scores(
    evaluations: Mapping[str, Evaluation], cfg: Evaluate, spec: ScenarioSpec, place: Place, console: Console
) -> tuple[dict[str, Score], str | None]:
    """Scores by controller, or why there are none; solves the episodes that are missing where that is asked for."""
    from dcgrid_env.baselines import published
    from dcgrid_env.baselines.hindsight_costs import FOLDER
    from dcgrid_env.baselines.score import REFERENCE

    if REFERENCE not in evaluations:
        return {}, f"no score: it is measured from {REFERENCE}"
    droop = evaluations[REFERENCE]
    scenario, seeds = droop.scenario, droop.seeds
    try:
        costs = published(scenario, FOLDER)
        missing = _missing(costs, seeds)
        if missing and not cfg.hindsight:
            return {}, _offer(scenario, missing, len(seeds), place.workers, console)
        if missing:
            solve_missing({scenario.name: spec}, cfg.split, {scenario.name: missing}, FOLDER, place, console)
            costs = published(scenario, FOLDER)
        return {name: evaluation.score(droop, costs) for name, evaluation in evaluations.items()}, None
    except ValueError as error:
        text = str(error)
        return {}, text if text.startswith("no score") else f"no score: {text}"


def _missing(costs: Published | None, seeds: Sequence[int]) -> list[int]:
    return costs.missing(seeds) if costs else list(seeds)


def _offer(scenario: Scenario, missing: Sequence[int], n: int, workers: int, console: Console) -> str:
    """Why there is no score, how to get it and about how long that takes, as far as one linear program tells."""
    from dcgrid_env.baselines.model_based.hindsight import effort_of, hindsight

    with console.status("how long hindsight would take"):
        began_s = time.perf_counter()
        hindsight(scenario, missing[0], rounds=1)
        program_s = time.perf_counter() - began_s
    turns, most = -(-len(missing) // workers), effort_of(scenario).rounds
    span = " to ".join(_duration(rounds * program_s * turns) for rounds in (2, most))
    return (
        f"no score: hindsight is not known for {len(missing)} of the {n} episodes; the same command with --hindsight "
        f"solves them, in about {span} (one linear program took {_duration(program_s)}, an episode takes 2 to "
        f"{most} of them, on {workers} {'processes' if workers > 1 else 'process'})"
    )


def _duration(seconds: float) -> str:
    """A time as one says it."""
    if seconds < 90.0:
        return f"{seconds:.2g} s" if seconds < 10.0 else f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


def table(evaluations: Mapping[str, Evaluation], scores: Mapping[str, Score], title: str) -> Table:
    """The controllers side by side."""
    from dcgrid_env import metrics_in
    from dcgrid_env.baselines.benchmark.benchmark_tables import SAVED, Table
    from dcgrid_env.baselines.score import REFERENCE, saved_pct

    rows = []
    if scores:
        for i, label in enumerate(("score", "95 % interval: from", "to")):
            rows.append((label, *(f"{scores[name].score[i]:.3f}" for name in evaluations)))
    if REFERENCE in evaluations:
        saved = (saved_pct(one.J, evaluations[REFERENCE].J) for one in evaluations.values())
        rows.append((SAVED, *(f"{share:.1f}" for share in saved)))
    for metric in metrics_in("evaluate"):
        rows.append((metric.heading, *(metric.text(one.means[metric.name]) for one in evaluations.values())))
    return Table(title, ("mean over episodes", *evaluations), tuple(rows))


def remarks(policy: str, evaluations: Mapping[str, Evaluation]) -> list[str]:
    """What must not be overlooked: delay that pays for voltage, and rules that measure nothing and do better."""
    from dcgrid_env import METRICS
    from dcgrid_env.agents.policy.guard import guard_line
    from dcgrid_env.baselines.score import REFERENCE, STATIC

    said, means = [], evaluations[policy].means
    delay, j = METRICS["delay_mean_s"], METRICS["J"]
    droop = evaluations[REFERENCE].means if REFERENCE in evaluations else means
    if delay.is_worse(means, droop):
        said.append(
            f"{policy}: work waits longer than under the tuned droop: mean delay {delay.text(means[delay.name])} s, "
            f"there {delay.text(droop[delay.name])} s"
        )
    if line := guard_line(policy, means):
        said.append(line)
    best = min(
        (name for name in STATIC if name in evaluations), key=lambda name: evaluations[name].means["J"], default=policy
    )
    if policy not in STATIC and j.is_worse(means, evaluations[best].means):
        said.append(
            f"{policy}: J {j.text(means['J'])} is above that of {best}, {j.text(evaluations[best].means['J'])}, which "
            "measures nothing"
        )
    return said
