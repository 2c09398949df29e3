"""The command ``dcgrid train``: a sub-command for each algorithm, whose options are found when it is asked for.

Each algorithm is a module of `dcgrid_env.agents` with a configuration dataclass, which is its command line, and main.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import tyro

from dcgrid_env.cli.command import Command
from dcgrid_env.core.install import from_clone


@dataclass(frozen=True)
class Algorithm:
    """An algorithm as a member of the group; it is imported when it is asked for, as it needs torch."""

    name: str
    """Its name on the command line, and, with underscores, of its module under ``dcgrid_env.agents.algorithms``."""
    text: str
    """What it does, on one line."""

    def about(self) -> str:
        """What it does."""
        return self.text

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
        first.add_argument("--view")
        try:
            begin = kind.for_scenario(**vars(first.parse_known_args(words)[0]))
        except argparse.ArgumentError:  # one without a value, which the whole command line reports below
            begin = kind()
        about = (self.module().__doc__ or "").strip()
        return tyro.cli(kind, args=words, default=begin, prog=prog, description=about)

    def parse(self, words: Sequence[str], prog: str) -> Command:
        """Read the algorithm's own options; ValueError where torch is not installed."""
        return Training(self.module(), self.configured(words, prog))


@dataclass(frozen=True)
class Training(Command):
    """Train a policy by an algorithm."""

    module: ModuleType
    """The algorithm's."""
    configuration: Any

    @property
    def resumes(self) -> str:
        """How to go on from the last checkpoint."""
        return "the same command with --resume goes on"

    def run(self) -> None:
        """Train. ValueError for a run that cannot begin or go on."""
        from dcgrid_env.agents.training.run_folder import TrainingError

        if line := shipped_settings(self.configuration):
            print(line)
        try:
            self.module.main(self.configuration)
        except TrainingError as error:
            raise ValueError(error) from error


ALGORITHMS = {
    algorithm.name: algorithm
    for algorithm in (
        Algorithm("ppo", "Proximal policy optimisation of Stable-Baselines3, shared or centralised."),
        Algorithm("ppo-counterfactual", "PPO on what each agent's own action changed in a step, by the grid's model."),
        Algorithm("sac", "Soft actor-critic of Stable-Baselines3, shared or centralised."),
        Algorithm("td3", "Twin delayed deep deterministic policy gradient of Stable-Baselines3."),
        Algorithm("analytic", "Gradients through the power flow, on local observations."),
        Algorithm("safe", "Gradients through the power flow, for monotone networks of bounded gain."),
        Algorithm("carry-over", "Corrections of the model-aided law, learned on random feeders for any feeder."),
    )
}
"""Algorithms by their names, each registered by its line."""


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
