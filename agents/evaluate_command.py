"""The command ``dcgrid evaluate``."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console

from dcgrid_env import METRICS, PRESETS, Scenario, metrics_in
from dcgrid_env.agents import Evaluation, evaluate, find_controller
from dcgrid_env.agents.controllers import trained_on
from dcgrid_env.agents.export_sb3_command import SUFFIX as SB3
from dcgrid_env.agents.policy.guard import guard_line
from dcgrid_env.agents.training.config import stored_config
from dcgrid_env.baselines import Controller, Published, published
from dcgrid_env.baselines.evaluation import below_static, headroom_lines
from dcgrid_env.baselines.hindsight_command import kept_episodes, solve_missing
from dcgrid_env.baselines.hindsight_costs import FOLDER
from dcgrid_env.baselines.model_based.hindsight import effort_of, hindsight
from dcgrid_env.baselines.registry import controller_file, require_known, split_prefix, tuned_from
from dcgrid_env.baselines.runs import draw_first
from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.baselines.score import REFERENCE, SAVED, Score, saved_pct, static_rules
from dcgrid_env.baselines.tuning.tuned import require_tuned
from dcgrid_env.baselines.user_code import parse
from dcgrid_env.core.commands.command import GOES_ON
from dcgrid_env.core.commands.opening import offer
from dcgrid_env.core.commands.settings import Overrides, check_folder
from dcgrid_env.core.commands.terminal import plain_console, say
from dcgrid_env.core.commands.workers import OverWorkers
from dcgrid_env.core.suggestions import from_clone
from dcgrid_env.core.text_table import Table
from dcgrid_env.core.work.unit import Place


@dataclass(frozen=True)
class Evaluate(OverWorkers):
    """Score a policy on held-out episodes.

    Compares it with the tuned droop and with the best rules that use no measurements.
    """

    policy: tyro.conf.Positional[str]
    """Policy to score: a bundled policy or controller (dcgrid list), a training run's folder, a policy file
    (.safetensors), a Stable-Baselines3 model (.zip) or your class (module:Class or file.py:Class, for example
    'file.py:Class(gain=0.5)'). The prefix guarded: keeps a policy near the tuned droop outside the conditions
    that it was trained in."""
    scenario: str | None = None
    """Scenario: a name (dcgrid list), path/to/file.toml, path/to/file.py:function or package.module:function. Default:
    the scenario that the policy was trained on."""
    set: Overrides = ()
    """Scenario fields to override, for example --set horizon=60 sensing.noise_pu=0.005."""
    split: str = "test"
    """Split of the episodes: train, validation, test or ood."""
    episodes: int = 100
    """Number of episodes, with seeds SEED, SEED + 1, ..."""
    seed: int = 0
    """Seed of the first episode."""
    hindsight: bool = False
    """Solve the hindsight costs that the score needs and store them in results/hindsight. Without this option, missing
    costs mean no score, and the command prints an estimate of the solution time."""
    tuned: Path | None = None
    """File with the gains of the tuned controllers, written by dcgrid tune. Default: results/tuned.json if it has gains
    for this exact scenario, otherwise the gains bundled with the preset."""
    trust: bool = False
    """Run code from files: let Stable-Baselines3 load a zip, which contains pickled code, or import the scenario code
    named in a training run's folder. Without it, only weights and text of a zip are read."""
    out: Path = Path("results/evaluate")
    """Folder for figure.png, which shows the first episode under the policy and the tuned droop. Created if missing."""
    open: bool = False
    """Open the figure when the command ends."""

    @property
    def resumes(self) -> str:
        """Message on how to resume; finished work is kept."""
        return GOES_ON if self.hindsight else ""

    def run(self) -> None:
        """Run the episodes, print the table and remarks; raise ValueError if a setting is invalid."""
        require_tuned(self.tuned)
        place = self.place
        check_folder(self.out)
        spec = _scenario_of(self)
        scenario = spec.make(self.split)
        seeds = range(self.seed, self.seed + self.episodes)
        if self.hindsight:
            kept_episodes(FOLDER, scenario)  # raise ValueError for a file of another scenario before any run
        zipped = _zipped(self.policy) if self.trust else None
        controller = _sb3(zipped) if zipped else find_controller(self.policy, scenario, self.tuned)
        controllers = {self.policy: controller}
        left_out = []
        for name in (REFERENCE, *static_rules(scenario)):
            try:
                controllers.setdefault(name, find_controller(name, scenario, self.tuned))
            except ValueError as error:
                left_out.append(f"{name} is omitted: {error}")
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
            said += headroom_lines(costs.select(seeds), evaluations[REFERENCE].J)
        for line in [*said, *tuned_from(list(controllers), scenario, self.tuned)]:
            console.print(line)
        shown = {name: controllers[name] for name in (self.policy, REFERENCE) if name in controllers}
        figure = draw_first(scenario, self.seed, shown, self.out, console)
        say(console, f"wrote {figure}")
        offer(console, figure, self.open)


def _zipped(policy: str) -> Path | None:
    """Return the Stable-Baselines3 zip that a policy name or its folder refers to; None for anything else."""
    before, inner = split_prefix(policy)
    file = None if before else controller_file(inner)  # a zip cannot be guarded
    return file if file is not None and file.suffix == SB3 else None


def _sb3(file: Path) -> Controller:
    """Return the model of a trusted zip; raise ValueError if it cannot be loaded or a package is missing."""
    try:
        from dcgrid_env.agents.from_sb3.sb3_controller import trusted
    except ImportError as error:
        raise ValueError(f"policy {str(file)!r} needs {error.name}; {from_clone('agents')}") from None
    return trusted(file)


def _scenario_of(cfg: Evaluate) -> ScenarioSpec:
    """Return the scenario of the command line or of the policy's training; raise ValueError if there is neither."""
    if cfg.scenario is not None:
        return ScenarioSpec(cfg.scenario, cfg.set)
    _, inner = split_prefix(cfg.policy)
    file = controller_file(inner)
    if file is not None and Path(inner).is_dir():
        where, overrides = _of_training(Path(inner), cfg.trust)
        if where and "," not in where:
            return ScenarioSpec(where, (*overrides, *cfg.set))
    where = trained_on(cfg.policy)
    if where not in PRESETS:
        require_known(inner)
        raise ValueError(
            f"scenario: must be given for policy {inner!r}, which is not tied to a preset; add --scenario (dcgrid list)"
        )
    return ScenarioSpec(where, cfg.set)


def _of_training(folder: Path, trust: bool) -> tuple[str, tuple[str, ...]]:
    """Return scenario and overrides of a training run, empty if it has no such file.

    Raises ValueError if the file is invalid, or names a scenario that is code and ``trust`` is not set.
    """
    trained, config = stored_config(folder) or {}, folder / "config.json"
    where, overrides = trained.get("scenario", ""), trained.get("set", [])
    if not isinstance(overrides, list) or not all(isinstance(word, str) for word in (where, *overrides)):
        raise ValueError(f"{config}: scenario and set must be text; pass --scenario and the policy file")
    if where and parse(where) is not None and not trust:
        raise ValueError(
            f"{config}: scenario must not be code unless trusted, got {where!r}; pass it with --scenario, or add "
            "--trust if you trust the author of the folder"
        )
    return where, tuple(overrides)


def _scores(
    evaluations: Mapping[str, Evaluation], cfg: Evaluate, spec: ScenarioSpec, place: Place, console: Console
) -> tuple[dict[str, Score], str | None]:
    """Return scores by controller, or the reason why there are none; solve missing episodes with --hindsight."""
    if REFERENCE not in evaluations:
        return {}, f"no score: it needs {REFERENCE} as the baseline"
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
    """Return why the score is missing and how long --hindsight would take, estimated from one linear program."""
    with console.status("estimating the time for hindsight"):
        began_s = time.perf_counter()
        hindsight(scenario, missing[0], rounds=1)
        program_s = time.perf_counter() - began_s
    turns, most = -(-len(missing) // workers), effort_of(scenario).rounds
    span = " to ".join(_duration(rounds * program_s * turns) for rounds in (2, most))
    return (
        f"no score: hindsight costs are missing for {len(missing)} of the {n} episodes; add --hindsight to solve them "
        f"in about {span} (one linear program takes {_duration(program_s)}, an episode needs 2 to {most}, on {workers} "
        f"{'processes' if workers > 1 else 'process'})"
    )


def _duration(seconds: float) -> str:
    """Return a duration with a suitable unit."""
    if seconds < 90.0:
        return f"{seconds:.2g} s" if seconds < 10.0 else f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


def table(evaluations: Mapping[str, Evaluation], scores: Mapping[str, Score], title: str) -> Table:
    """Return the table with one column per controller."""
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
    """Return warnings: a longer delay than under the droop, and better results of rules that use no measurements."""
    said, means = [], evaluations[policy].means
    delay = METRICS["delay_mean_s"]
    droop = evaluations[REFERENCE].means if REFERENCE in evaluations else means
    if delay.is_worse(means, droop):
        said.append(
            f"{policy}: mean delay {delay.text(means[delay.name])} s is longer than the tuned droop's "
            f"{delay.text(droop[delay.name])} s"
        )
    if line := guard_line(policy, means):
        said.append(line)
    if line := below_static(policy, means, evaluations):
        said.append(line)
    return said
