"""Settings shared by all training algorithms.

The fields of an algorithm's configuration are its options on the command line.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

from dcgrid_env.agents.training.preset_settings import settings
from dcgrid_env.agents.training.setting_bounds import check_figures
from dcgrid_env.baselines.file_names import file_name
from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.core.user_files import read_json

Act = Literal["both", "clock", "q"]


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
            (``dcgrid_env.agents.training.preset_settings``), which take precedence over the algorithm's defaults.

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
RENAMED: dict[str, str] = {"lanes": "num_envs"}
"""Old names of configuration fields, as earlier runs may have stored them, and their current names."""


def stored_config(folder: Path) -> dict[str, Any] | None:
    """Return the configuration of the training run in a folder, with current field names; None if there is none.

    Raises ValueError with the file's path if the file cannot be read.
    """
    path = folder / "config.json"
    if not path.exists():
        return None
    try:
        stored: dict[str, Any] = read_json(path, ValueError, "train again")
        return {RENAMED.get(field, field): value for field, value in stored.items()}
    except (ValueError, AttributeError):
        raise ValueError(f"{path}: is no configuration of a training run") from None


def trained_on(cfg: Training) -> str:
    """Return the name of the training scenario for a policy's file: a preset or a description of the scenario."""
    return ScenarioSpec(cfg.scenario, cfg.set).label


def check(cfg: Training) -> None:
    """Raise ValueError with the field's name if a number is invalid."""
    check_figures(vars(cfg))
