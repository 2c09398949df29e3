"""Settings shared by all training algorithms.

The fields of an algorithm's configuration are its options on the command line.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, Self

from dcgrid_env import Scenario
from dcgrid_env.agents.policy.history_network import MOST_STEPS
from dcgrid_env.baselines.file_names import file_name
from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.core.user_files import read_json

Act = Literal["both", "clock", "q"]
MOST_SEEDS = 2**24
"""Training seeds whose episodes are not those of another one."""
_MANY = 1e9
ABOVE_0: Mapping[str, float] = {
    **dict.fromkeys(("num_envs", "validation_episodes", "population", "elites", "window"), 100_000),
    **dict.fromkeys(("feeders", "validation_feeders"), 10_000),
    **dict.fromkeys(("updates", "iterations"), _MANY),
    **dict.fromkeys(("validate_every", "checkpoint_every"), _MANY),
    **dict.fromkeys(("max_grad_norm", "trip_width_s", "delay_limit_s", "violation_limit_pu"), _MANY),
    **dict.fromkeys(("dual_rate", "std"), 10.0),
    "learning_rate": 1.0,
    "steps": 1e15,
    "threads": 4096,
}
"""Largest value of what must be above 0."""
WITHIN: Mapping[str, tuple[float, float]] = {
    "seed": (0, MOST_SEEDS - 1),
    "extra_std": (0.0, 10.0),
    "vary": (0, 10_000),
    "history": (0, MOST_STEPS),
    "trip_width_pu": (0.0, 1.0),
    "margin": (1e-6, 1.0 - 1e-6),
}
"""Least and largest value of all others."""
WIDEST = 65_536
"""Most units of a hidden layer."""
MOST_WEIGHTS = 2**26
"""Most weights between hidden layers; a policy file of them is as large as files that are read."""
PRESET_SETTINGS = Path(__file__).with_name("preset_settings.toml")


@cache
def all_settings() -> dict[str, dict[str, dict[str, Any]]]:
    """Return the tuned settings by algorithm and preset."""
    return tomllib.loads(PRESET_SETTINGS.read_text(encoding="utf-8"))


def settings(algorithm: str, scenario: str) -> dict[str, Any]:
    """Return the tuned settings of an algorithm on a preset by field; empty if there are none."""
    found = all_settings().get(algorithm, {}).get(scenario, {})
    return {name: tuple(value) if isinstance(value, list) else value for name, value in found.items()}


@dataclass(frozen=True)
class Training:
    """Training and validation settings of an algorithm.

    Fields that are left out have the algorithm's defaults. :meth:`for_scenario` uses the tuned settings of a scenario.
    """

    scenario: str = "ieee123"
    """Training scenario: a preset, path/to/file.toml, path/to/file.py:function or package.module:function. analytic and
    safe also accept several, separated by commas."""
    set: tuple[str, ...] = ()
    """Scenario fields to override, as FIELD=VALUE. Example: --set horizon=60 background.load_sigma=0.1."""
    view: str | None = None
    """What the policy observes and controls."""
    seed: int = 0
    """Random seed of the training."""
    out: Path | None = None
    """Output folder of the run. Default: results/train/SCENARIO-ALGORITHM-SEED."""
    device: str = "cpu"
    """Torch device of the networks, for example cpu or cuda; analytic and safe also simulate the grid on it. cem and
    carry-over use the CPU only."""
    resume: bool = False
    """Continue from the checkpoint in the output folder."""
    num_envs: int = 128
    """Number of environments that are simulated in parallel, each with a separate episode."""
    validation_episodes: int = 32
    """Number of episodes of the validation split on which a policy is evaluated."""
    validate_every: int = 10
    """Iterations between validations; an iteration is a batch of complete episodes."""
    threads: int = 1
    """Number of torch threads. More threads help small networks little and slow them down when other processes run."""

    @classmethod
    def for_scenario(cls, scenario: str | None = None, view: str | None = None, **fields: Any) -> Self:
        """Return the configuration that ``dcgrid train`` uses for a scenario if no options are given.

        Parameters
        ----------
        scenario, view
            Training scenario and view; the algorithm's defaults if left out.
        fields
            Further fields, by name. They take precedence over the tuned settings of the scenario
            (``preset_settings.toml``), which take precedence over the algorithm's defaults.

        Raises
        ------
        TypeError
            If a field does not exist.
        """
        chosen: dict[str, Any] = {"scenario": scenario or cls.scenario, "view": view or cls.view}
        found = settings(cls.algorithm(), chosen["scenario"]) if chosen["view"] == cls.view else {}
        return cls(**(found | chosen | fields))

    @property
    def folder(self) -> Path:
        """Output folder of the run; raises ValueError if its name contains a scenario and the scenario is invalid."""
        return self.out or Path("results/train") / f"{self.subject}-{self.kind}-{self.seed}"

    @property
    def subject(self) -> str:
        """First part of the folder name: the training scenarios."""
        named = [name.strip() for name in self.scenario.split(",") if name.strip()]
        return "+".join(file_name(ScenarioSpec(name, self.set).make("validation").name) for name in named)

    @property
    def kind(self) -> str:
        """Second part of the folder name: the algorithm."""
        return self.algorithm()

    @classmethod
    def algorithm(cls) -> str:
        """Name of the algorithm on the command line."""
        return re.sub("(?<=[a-z])(?=[A-Z])", "-", cls.__name__).lower()


@dataclass(frozen=True)
class NetworkTraining(Training):
    """Further settings of the algorithms whose networks act for agents."""

    view: Literal["shared", "centralised"] = "shared"
    """shared: one policy, applied to each agent's observations. centralised: one policy that observes and controls all
    agents."""
    observe: Literal["local", "neighbours", "feeder"] = "local"
    """Scope of observation."""
    preview: bool = True
    """Include p_ref of the next step in the observation, if the scenario provides it."""
    act: Act = "both"
    """Actions that the policy controls. A clock that it does not control stays at its maximum, a reactive power at
    zero."""
    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers; empty for an affine function."""
    checkpoint_every: int = 10
    """Iterations between checkpoints."""


FREE = ("out", "resume")
"""Configuration fields that do not affect the result; a resumed run may change them."""


def stored_config(folder: Path) -> dict[str, Any] | None:
    """Return the configuration of the training run in a folder; None if there is none.

    Raises ValueError with the file's path if the file cannot be read.
    """
    path = folder / "config.json"
    if not path.exists():
        return None
    stored = read_json(path, ValueError, "train again")
    if not isinstance(stored, dict):
        raise ValueError(f"{path}: is no configuration of a training run")
    return stored


def trained_on(cfg: Training) -> str:
    """Return the name of the training scenario for a policy's file: a preset or a description of the scenario."""
    return ScenarioSpec(cfg.scenario, cfg.set).label


def check(cfg: Training) -> None:
    """Raise ValueError, naming the field, if a number is out of its bounds; None is ignored."""
    for field, value in vars(cfg).items():
        if value is None:
            continue
        if field in ABOVE_0 and not (0 < value <= ABOVE_0[field]):
            raise ValueError(f"{field} is {value}; give more than 0 and at most {ABOVE_0[field]:g}")
        if field in WITHIN and not WITHIN[field][0] <= value <= WITHIN[field][1]:
            low, high = WITHIN[field]
            raise ValueError(f"{field} is {value}; give at least {low:g} and at most {high:.9g}")
    hidden = getattr(cfg, "hidden", ())
    if not all(0 < width <= WIDEST for width in hidden):
        raise ValueError(f"hidden is {hidden}; give widths from 1 to {WIDEST}")
    if sum(one * other for one, other in pairwise(hidden)) > MOST_WEIGHTS:
        raise ValueError(f"hidden is {hidden}; give widths with at most {MOST_WEIGHTS:,} weights between the layers")


def scenarios(names: str, overrides: tuple[str, ...] = (), split: str = "train", **chosen: object) -> list[Scenario]:
    """Return the scenarios in a comma-separated string, with overrides ``FIELD=VALUE`` and further fields.

    Raises ValueError if a scenario is invalid or there is none.
    """
    given = [name.strip() for name in names.split(",") if name.strip()]
    if not given:
        raise ValueError(f"scenario: must name at least one scenario (dcgrid list), got {names!r}")
    return [ScenarioSpec(name, overrides).make(split, **chosen) for name in given]
