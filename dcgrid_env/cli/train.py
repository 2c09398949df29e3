"""The command ``dcgrid train``: a sub-command for each algorithm, whose options are found when it is asked for.

Each algorithm is a module of `dcgrid_env.agents` with a configuration dataclass, which is its command line, and main.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, get_args, get_type_hints

from dcgrid_command.command_table import COMMANDS
from dcgrid_command.group import Entry
from dcgrid_env.cli.command import GOES_ON, Command
from dcgrid_env.cli.opening import offer
from dcgrid_env.cli.options import parsed
from dcgrid_env.cli.progress import progress_bar
from dcgrid_env.cli.terminal import plain_console, say
from dcgrid_env.cli.workers import place
from dcgrid_env.core.install import from_clone

OWN = {"--open": "opens", "--wandb": "wandb"}
"""Options of the command beside an algorithm's configuration, and the fields that they set."""
SEEDS = (
    "With --seeds N it trains the seeds SEED to SEED + N - 1 at once, each in a folder of its own: --workers says how "
    "many at a time on this machine, by default one for each core, and --ray ADDRESS names the Ray cluster that trains "
    "them instead (auto, HOST:PORT, ray://HOST:PORT). --open opens the curve at the end, --wandb sends it to Weights & "
    "Biases as well."
)
"""What the help of every algorithm says of the options that stand beside its configuration."""


@dataclass(frozen=True)
class Algorithm:
    """A training algorithm; its module is imported when it is asked for, as it needs torch."""

    name: str
    """Its name on the command line, and, with underscores, of its module under ``dcgrid_env.agents.algorithms``."""

    def module(self) -> ModuleType:
        """Import the algorithm's module; ValueError, saying what to install, where a package is missing."""
        try:
            return importlib.import_module(f"dcgrid_env.agents.algorithms.{self.name.replace('-', '_')}")
        except ImportError as error:
            if (error.name or "").startswith("dcgrid_env"):
                raise
            raise ValueError(f"training: {error}; install it {from_clone('agents')}") from None

    def configuration(self) -> type[Any]:
        """The class of its configuration, which has the algorithm's name; ValueError as for ``module``."""
        return getattr(self.module(), "".join(map(str.capitalize, self.name.split("-"))))

    def configured(self, words: Sequence[str], prog: str = "dcgrid train") -> Any:
        """The configuration that options give.

        Where an option is not given it is what was found for the scenario, and else the algorithm's default.
        """
        kind = self.configuration()
        # Which defaults there are depends on two of the options: they are read first.
        first = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
        first.add_argument("--scenario")
        first.add_argument("--view", choices=get_args(get_type_hints(kind)["view"]))
        try:
            begin = kind.for_scenario(**vars(first.parse_known_args(words)[0]))
        except argparse.ArgumentError:  # no value, or no view, which the whole command line reports below
            begin = kind()
        return parsed(kind, words, prog, f"{(self.module().__doc__ or '').strip()}\n\n{SEEDS}", begin)

    @classmethod
    def parse(cls, words: Sequence[str], prog: str) -> Command:
        """Read the options of the algorithm that is the last word of ``prog``.

        ValueError if torch is not installed or a seed is invalid.
        """
        algorithm = cls(prog.split()[-1])
        asked, words = _seeds(words)
        single_options = {field: option in words for option, field in OWN.items()}
        configuration = algorithm.configured([word for word in words if word not in OWN], prog)
        if asked.seeds is None:
            return Training(algorithm.module(), configuration, **single_options)
        if any(single_options.values()):
            raise ValueError(f"seeds: {' and '.join(OWN)} are of a single training; leave them out, or --seeds")
        configurations = tuple(of_seed(configuration, configuration.seed + i) for i in range(asked.seeds))
        return Seeds(configurations, asked.workers, asked.ray)


@dataclass(frozen=True)
class Training(Command):
    """Train a policy by an algorithm."""

    module: ModuleType
    """The algorithm's."""
    configuration: Any
    opens: bool = False
    """Open the curve at the end."""
    wandb: bool = False
    """Send what goes to TensorBoard to Weights & Biases as well."""

    @property
    def resumes(self) -> str:
        """How to go on from the last checkpoint."""
        return "the same command with --resume goes on"

    def run(self) -> None:
        """Train. ValueError for a run that cannot begin or go on."""
        from dcgrid_env.agents.training.run_folder import TrainingError
        from dcgrid_env.cli.weights_and_biases import logged

        if line := shipped_settings(self.configuration):
            print(line)
        try:
            with logged(self.configuration, self.wandb):
                folder = self.module.main(self.configuration)
        except TrainingError as error:
            raise ValueError(error) from error
        console = plain_console()
        say(console, f"`dcgrid evaluate {folder}` scores it; `tensorboard --logdir {folder}` draws its curve")
        offer(console, Path(folder) / "curve.csv", self.opens)


@dataclass(frozen=True)
class Seeds(Command):
    """Train a policy for each of several seeds, several at once."""

    configurations: tuple[Any, ...]
    """One for each seed."""
    workers: int | None = None
    """Trainings at once on this machine."""
    ray: str | None = None
    """Ray cluster that trains them instead."""

    @property
    def resumes(self) -> str:
        """How to go on: each seed from its last checkpoint."""
        return GOES_ON

    def run(self) -> None:
        """Train what has not been trained, print each seed's cost on validation. ValueError where seeds fail."""
        from dcgrid_env.agents import Card
        from dcgrid_env.agents.training.training_runs import train_all, train_seed, words_of

        where, first = place(self.workers, self.ray), self.configurations[0]
        if line := shipped_settings(first):
            print(line)
        console, failures = plain_console(), {}
        with progress_bar(console) as progress:
            bar = progress.add_task("seeds", total=len(self.configurations))
            for configuration, failure in train_all(self.configurations, where, train_seed, words_of):
                if failure is not None:
                    failures[configuration.seed] = failure
                progress.advance(bar)
        if failures:
            said = "; ".join(f"seed {seed}: {failures[seed]}" for seed in sorted(failures))
            raise ValueError(f"{len(failures)} of {len(self.configurations)} not done: {said}; {GOES_ON}")
        folders = {configuration.seed: configuration.folder for configuration in self.configurations}
        cards = {seed: Card.load(folders[seed] / "policy.json") for seed in sorted(folders)}
        for seed, card in cards.items():
            cost, spent_s = f"J {card.validation_J:.4f} on validation", f"{card.training_s:.0f} s"
            say(console, f"seed {seed}: {cost}, {spent_s}, {folders[seed]}")
        costs, where = [card.validation_J or 0.0 for card in cards.values()], " ".join(str(folders[s]) for s in cards)
        say(console, f"J {sum(costs) / len(costs):.4f} on average, {min(costs):.4f} to {max(costs):.4f}")
        say(console, f"`dcgrid ship {where} --name NAME` scores them on test")


def of_seed(configuration: Any, seed: int) -> Any:
    """A configuration with this seed, in a folder of its own within the one that is given."""
    out = configuration.out and configuration.out / f"seed-{seed}"
    return dataclasses.replace(configuration, seed=seed, out=out)


def _seeds(words: Sequence[str]) -> tuple[argparse.Namespace, list[str]]:
    """What is asked for of several seeds (``seeds`` None for the one of --seed), and the other words.

    ValueError for what cannot be.
    """
    option = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    option.add_argument("--seeds", type=int)
    option.add_argument("--workers", type=int)
    option.add_argument("--ray")
    try:
        given, others = option.parse_known_args(words)
    except argparse.ArgumentError as error:
        field = (error.argument_name or "seeds").lstrip("-")
        raise ValueError(f"{field}: {error.message}; give it a value, such as --seeds 5 --workers 2") from None
    if given.seeds is not None and given.seeds < 1:
        raise ValueError(f"seeds is {given.seeds}; give at least 1")
    if given.seeds is None and (given.workers is not None or given.ray is not None):
        raise ValueError("seeds is missing: --workers and --ray share out several trainings; give --seeds, or neither")
    return given, others


ALGORITHMS = {
    line.split()[-1]: Algorithm(line.split()[-1])
    for line, member in COMMANDS.below("dcgrid")
    if isinstance(member, Entry) and member.where == "train:Algorithm"
}
"""Algorithms by name, as the table of commands has them."""


def shipped_settings(configuration: Any) -> str:
    """Which settings of a configuration are those that ship for its scenario; empty where none are."""
    from dcgrid_env.agents.training.preset_settings import settings

    name = configuration.algorithm()
    shipped = settings(name, configuration.scenario, configuration.view)
    taken = {field: value for field, value in shipped.items() if getattr(configuration, field) == value}
    if not taken:
        return ""
    shown = (f"{field} {value:g}" if isinstance(value, float) else f"{field} {value}" for field, value in taken.items())
    return f"settings that ship for {name} on {configuration.scenario}: {', '.join(shown)} (options stand before them)"
