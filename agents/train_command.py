"""The command ``dcgrid train``: a sub-command for each algorithm.

Each algorithm is a module of `dcgrid_env.agents` with ``main`` and a configuration dataclass, which is its options.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, get_args, get_type_hints

from dcgrid_command.command_table import COMMANDS
from dcgrid_env.agents import Card
from dcgrid_env.agents.training.config import settings
from dcgrid_env.core.commands.command import GOES_ON, Command
from dcgrid_env.core.commands.option_limits import check_limit
from dcgrid_env.core.commands.options import parsed
from dcgrid_env.core.commands.progress import progress_bar
from dcgrid_env.core.commands.terminal import plain_console, say
from dcgrid_env.core.commands.workers import place
from dcgrid_env.core.suggestions import from_clone

STABLE_BASELINES3 = ("ppo", "sac", "td3")
"""Algorithms of the module ``sb3``."""
SEEDS = (
    "Further options: --seeds N trains N policies with the seeds SEED to SEED + N - 1, each in a separate folder. "
    "--workers sets how many run in parallel on this machine (default: one per core). --ray ADDRESS trains them on a "
    "Ray cluster instead (auto, HOST:PORT or ray://HOST:PORT)."
)
"""Help on the options that every algorithm has in addition to its configuration."""


@dataclass(frozen=True)
class Algorithm:
    """A training algorithm; its module needs torch and is imported on first use."""

    name: str
    """Name on the command line."""

    def module(self) -> ModuleType:
        """Import the algorithm's module; raise ValueError with the install command if a package is missing."""
        name = "sb3" if self.name in STABLE_BASELINES3 else self.name.replace("-", "_")
        try:
            return importlib.import_module(f"dcgrid_env.agents.algorithms.{name}")
        except ImportError as error:
            if (error.name or "").startswith("dcgrid_env"):
                raise
            raise ValueError(f"training: {error}; install it {from_clone('agents')}") from None

    def configuration(self) -> type[Any]:
        """Return the configuration class, which has the algorithm's name; errors are those of ``module``."""
        return getattr(self.module(), "".join(map(str.capitalize, self.name.split("-"))))

    def configured(self, words: Sequence[str], prog: str = "dcgrid train") -> Any:
        """Return the configuration that the options define.

        Options that are not given default to the tuned settings for the scenario, or to the algorithm's defaults.
        """
        kind = self.configuration()
        # The defaults depend on the scenario and the view, which are read first.
        first = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
        first.add_argument("--scenario")
        views = [view for part in get_args(get_type_hints(kind)["view"]) for view in get_args(part) or (part,)]
        first.add_argument("--view", choices=views, default=argparse.SUPPRESS)
        try:
            begin = kind.for_scenario(**vars(first.parse_known_args(words)[0]))
        except argparse.ArgumentError:  # a missing or invalid value, which tyro reports below
            begin = kind()
        return parsed(kind, words, prog, f"{(self.module().__doc__ or '').strip()}\n\n{SEEDS}", begin)

    @classmethod
    def parse(cls, words: Sequence[str], prog: str) -> Command:
        """Parse the options of the algorithm that is the last word of ``prog``.

        Raises ValueError if torch is not installed or a seed is invalid.
        """
        algorithm = cls(prog.split()[-1])
        asked, words = _seeds(words)
        configuration = algorithm.configured(words, prog)
        if asked.seeds is None:
            return Training(algorithm.module(), configuration)
        configurations = tuple(of_seed(configuration, configuration.seed + i) for i in range(asked.seeds))
        return Seeds(configurations, asked.workers, asked.ray)


@dataclass(frozen=True)
class Training(Command):
    """Train a policy with one algorithm."""

    module: ModuleType
    """Module of the algorithm."""
    configuration: Any

    @property
    def resumes(self) -> str:
        """Message on how to resume from the last checkpoint."""
        return "run the same command with --resume to continue"

    def run(self) -> None:
        """Train; raise ValueError if the run cannot start or resume."""
        from dcgrid_env.agents.training.run_folder import TrainingError

        if line := shipped_settings(self.configuration):
            print(line)
        try:
            folder = self.module.main(self.configuration)
        except TrainingError as error:
            raise ValueError(error) from error
        say(plain_console(), f"score it: dcgrid evaluate {folder}; plot its curve: tensorboard --logdir {folder}")


@dataclass(frozen=True)
class Seeds(Command):
    """Train one policy for each of several seeds, in parallel."""

    configurations: tuple[Any, ...]
    """Configurations, one for each seed."""
    workers: int | None = None
    """Number of parallel trainings on this machine."""
    ray: str | None = None
    """Ray cluster to train on instead."""

    @property
    def resumes(self) -> str:
        """Message on how to resume; each seed continues from its last checkpoint."""
        return GOES_ON

    def run(self) -> None:
        """Train the remaining seeds and print the validation cost of each; raise ValueError if a seed fails."""
        from dcgrid_env.agents.training.training_runs import train_all, words_of

        where, first = place(self.workers, self.ray), self.configurations[0]
        if line := shipped_settings(first):
            print(line)
        console, failures = plain_console(), {}
        with progress_bar(console) as progress:
            bar = progress.add_task("seeds", total=len(self.configurations))
            for configuration, failure in train_all(self.configurations, where, words_of):
                if failure is not None:
                    failures[configuration.seed] = failure
                progress.advance(bar)
        if failures:
            said = "; ".join(f"seed {seed}: {failures[seed]}" for seed in sorted(failures))
            raise ValueError(f"{len(failures)} of {len(self.configurations)} trainings failed: {said}; {GOES_ON}")
        folders = {configuration.seed: configuration.folder for configuration in self.configurations}
        cards = {seed: Card.load(folders[seed] / "policy.json") for seed in sorted(folders)}
        for seed, card in cards.items():
            cost, spent_s = f"J {card.validation_J:.4f} on validation", f"{card.training_s:.0f} s"
            say(console, f"seed {seed}: {cost}, {spent_s}, {folders[seed]}")
        costs = [card.validation_J or 0.0 for card in cards.values()]
        best = folders[min(cards, key=lambda seed: cards[seed].validation_J or 0.0)]
        say(console, f"J {sum(costs) / len(costs):.4f} on average, {min(costs):.4f} to {max(costs):.4f}")
        say(console, f"score the best on the test split: dcgrid evaluate {best}")


def of_seed(configuration: Any, seed: int) -> Any:
    """Return a configuration with this seed and a separate folder for it."""
    out = configuration.out and configuration.out / f"seed-{seed}"
    return dataclasses.replace(configuration, seed=seed, out=out)


def _seeds(words: Sequence[str]) -> tuple[argparse.Namespace, list[str]]:
    """Return the options for several seeds (``seeds`` is None for a single one), and the other words.

    Raises ValueError if an option is invalid.
    """
    option = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    option.add_argument("--seeds", type=int)
    option.add_argument("--workers", type=int)
    option.add_argument("--ray")
    try:
        given, others = option.parse_known_args(words)
    except argparse.ArgumentError as error:
        field = (error.argument_name or "seeds").lstrip("-")
        raise ValueError(f"{field}: {error.message}; give a value, for example --seeds 5 --workers 2") from None
    if given.seeds is not None:
        check_limit("seeds", given.seeds)
    if given.seeds is None and (given.workers is not None or given.ray is not None):
        raise ValueError(
            "seeds: must be given with --workers or --ray, which train several seeds; add --seeds N, or remove them"
        )
    return given, others


ALGORITHMS = {
    line.split()[-1]: Algorithm(line.split()[-1])
    for line, _ in COMMANDS.below("dcgrid")
    if line.startswith("dcgrid train ")
}
"""Algorithms by name, in the order of the command table."""


def shipped_settings(configuration: Any) -> str:
    """Return a line with the settings that come from the bundled ones for the scenario; empty if none do."""
    name = configuration.algorithm()
    if configuration.view != type(configuration).view:
        return ""
    shipped = settings(name, configuration.scenario)
    taken = {field: value for field, value in shipped.items() if getattr(configuration, field) == value}
    if not taken:
        return ""
    shown = (f"{field} {value:g}" if isinstance(value, float) else f"{field} {value}" for field, value in taken.items())
    return f"bundled settings for {name} on {configuration.scenario}: {', '.join(shown)} (options override them)"
