"""Settings of every algorithm: each algorithm's configuration, which is its command line, begins with these fields."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

from dcgrid_env.agents.training.preset_settings import settings
from dcgrid_env.agents.training.setting_bounds import check_figures
from dcgrid_env.baselines.file_names import file_name
from dcgrid_env.baselines.scenario_spec import ScenarioSpec

Act = Literal["both", "clock", "q"]


@dataclass(frozen=True)
class Training:
    """What to train, and how it is judged.

    Fields that are not given are the algorithm's own defaults; :meth:`for_scenario` takes what was found for
    a scenario.
    """

    scenario: str = "ieee123"
    """What to train on: a preset, or one of your own, path/to/file.toml, or path/to/file.py:function or
    package.module:function that makes it; for analytic and safe also several, separated by commas."""
    set: tuple[str, ...] = ()
    """Fields of the scenario to change, FIELD=VALUE, for instance --set horizon=60 background.load_sigma=0.1."""
    view: Literal["shared", "centralised"] = "shared"
    """One policy for all agents on their own observations, or one that observes and drives all of them."""
    seed: int = 0
    """Random seed of the training."""
    out: Path | None = None
    """Folder of the run; results/train/SCENARIO-ALGORITHM-SEED by default."""
    device: str = "cpu"
    """Where the networks live, and for analytic and safe the grid, as torch names it."""
    resume: bool = False
    """Go on from the folder's checkpoint."""
    observe: Literal["local", "neighbours", "feeder"] = "local"
    """Scope of observation."""
    preview: bool = True
    """Whether p_ref of the coming step is observed (where the scenario shows it)."""
    act: Act = "both"
    """What the policy has in hand; the rest is held at the top clock or at no reactive power."""
    num_envs: int = 128
    """Environments that are stepped at once, each with an episode of its own."""
    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers."""
    validation_episodes: int = 32
    """Episodes of the validation split that a policy is judged on."""
    validate_every: int = 10
    """Iterations, batches of whole episodes, from one validation to the next."""
    checkpoint_every: int = 10
    """Iterations from one checkpoint to the next."""
    threads: int = 1
    """Threads of torch; networks this small gain little from more, and lose much where other processes compete."""

    @classmethod
    def for_scenario(cls, scenario: str | None = None, view: str | None = None, **fields: Any) -> Self:
        """The configuration with which ``dcgrid train`` begins on a scenario, before its options.

        Parameters
        ----------
        scenario, view
            What to train on, and for whom; the algorithm's defaults unless given.
        fields
            Further fields, by name; they stand before those that were found for the scenario
            (``dcgrid_env.agents.training.preset_settings``), and those before the algorithm's defaults.

        Raises
        ------
        TypeError
            For a field that there is not.
        """
        chosen: dict[str, Any] = {"scenario": scenario or cls.scenario, "view": view or cls.view}
        return cls(**(settings(cls.algorithm(), **chosen) | chosen | fields))

    @property
    def folder(self) -> Path:
        """Folder of the run; ValueError where it is named after a scenario that cannot be."""
        return self.out or Path("results/train") / f"{self.subject}-{self.kind}-{self.seed}"

    @property
    def subject(self) -> str:
        """What a run's folder is named after first: what is trained on."""
        named = [name.strip() for name in self.scenario.split(",") if name.strip()]
        return "+".join(file_name(ScenarioSpec(name, self.set).make("validation").name) for name in named)

    @property
    def kind(self) -> str:
        """What a run's folder is named after next."""
        return self.algorithm()

    @classmethod
    def algorithm(cls) -> str:
        """Name of the algorithm on the command line."""
        return re.sub("(?<=[a-z])(?=[A-Z])", "-", cls.__name__).lower()


RENAMED: dict[str, str] = {"lanes": "num_envs"}
"""Fields of a configuration by the names under which earlier runs may have stored them."""


def stored_config(folder: Path) -> dict[str, Any] | None:
    """Configuration of the training run in a folder, by the names that its fields have now; None where there is none.

    ValueError, naming the file, where it cannot be read.
    """
    path = folder / "config.json"
    if not path.exists():
        return None
    try:
        stored: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return {RENAMED.get(field, field): value for field, value in stored.items()}
    except (ValueError, AttributeError):
        raise ValueError(f"{path}: is no configuration of a training run") from None


def trained_on(cfg: Training) -> str:
    """Name of the training scenario for a policy's file: the preset, or a description of another scenario."""
    return ScenarioSpec(cfg.scenario, cfg.set).label


def check(cfg: Training) -> None:
    """Raise ValueError, naming the field, if a figure is invalid."""
    check_figures(vars(cfg))
