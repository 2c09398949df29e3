"""Train a policy; `dcgrid train ALGORITHM --help` shows its options.

Each algorithm is a module of `dcgrid_env.agents` with a configuration dataclass, which is its command line, and main.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import tyro

from dcgrid_env.core.install import from_clone


class Algorithm(NamedTuple):
    """Where an algorithm stands."""

    module: str
    """Under dcgrid_env.agents.algorithms."""
    config: str
    """Its configuration's class."""
    about: str
    """One line."""


ALGORITHMS = {
    "ppo": Algorithm("ppo", "Ppo", "proximal policy optimisation of Stable-Baselines3, shared or centralised"),
    "sac": Algorithm("sac", "Sac", "soft actor-critic of Stable-Baselines3, shared or centralised"),
    "td3": Algorithm("td3", "Td3", "twin delayed deep deterministic policy gradient of Stable-Baselines3"),
    "analytic": Algorithm("analytic", "Analytic", "gradients through the power flow, local observations"),
    "safe": Algorithm("safe", "Safe", "the same with monotone networks of bounded gain"),
}
"""By the name on the command line; imported when asked for, as they need torch."""


@dataclass(frozen=True)
class Train:
    """What to train."""

    algorithm: tyro.conf.Positional[str]
    """Its name; its own options follow (dcgrid train ALGORITHM --help)."""


ABOUT = "\n\n".join((
    "Train a policy; `dcgrid train ALGORITHM --help` shows its options.",
    *(f"{name}: {found.about}" for name, found in ALGORITHMS.items()),
))  # fmt: skip
"""Help of the command."""


def main(arguments: Sequence[str]) -> None:
    """Train by the algorithm that is named first, with the options that follow it.

    ValueError for one that there is not, for options that cannot be, for torch not installed, and for a run that cannot
    begin or go on.
    """
    name, *options = arguments
    if name not in ALGORITHMS:
        listed = "; ".join(f"{known}: {found.about}" for known, found in ALGORITHMS.items())
        raise ValueError(f"unknown algorithm {name!r}; there are {listed}")
    module = imported(ALGORITHMS[name])
    from dcgrid_env.agents.training.run import TrainingError

    config = configured(name, options)
    if line := said(config):
        print(line)
    try:
        module.main(config)
    except TrainingError as error:
        raise ValueError(error) from error
    except KeyboardInterrupt:
        print("dcgrid: interrupted; the same command with --resume goes on", file=sys.stderr)
        raise SystemExit(130) from None


def configured(name: str, options: Sequence[str]) -> Any:
    """An algorithm's configuration out of command-line options.

    Where an option is not given it is what was found for the scenario, and else the algorithm's default.
    """
    module = imported(ALGORITHMS[name])
    kind = getattr(module, ALGORITHMS[name].config)
    # Which defaults there are hangs on two of the options: they are read first.
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    first.add_argument("--scenario")
    first.add_argument("--view")
    try:
        begin = kind.for_scenario(**vars(first.parse_known_args(options)[0]))
    except argparse.ArgumentError:  # one without a value: the whole command line is told so below
        begin = kind()
    about = (module.__doc__ or "").strip()
    return tyro.cli(kind, args=options, default=begin, prog=f"dcgrid train {name}", description=about)


def said(config: Any) -> str:
    """Which settings of a configuration are those that ship for its scenario; empty where none are."""
    from dcgrid_env.agents.training.preset_settings import settings

    name = config.algorithm()
    found = settings(name, config.scenario, config.view)
    taken = {field: value for field, value in found.items() if getattr(config, field) == value}
    if not taken:
        return ""
    shown = (f"{field} {value:g}" if isinstance(value, float) else f"{field} {value}" for field, value in taken.items())
    return f"settings that ship for {name} on {config.scenario}: {', '.join(shown)} (options stand before them)"


def imported(algorithm: Algorithm) -> Any:
    """An algorithm's module; ValueError, saying which extra to install, where a package that it needs is missing."""
    try:
        return importlib.import_module(f"dcgrid_env.agents.algorithms.{algorithm.module}")
    except ImportError as error:
        if (error.name or "").startswith("dcgrid_env"):
            raise
        raise ValueError(f"training: {error}; install it {from_clone('agents')}") from None
