"""The command ``dcgrid tune-agent``."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_type_hints

import tyro

from dcgrid_env.baselines.scenario_names import one_scenario
from dcgrid_env.core.commands.command import GOES_ON
from dcgrid_env.core.commands.settings import alone_in
from dcgrid_env.core.commands.terminal import plain_console, say
from dcgrid_env.core.commands.workers import OverWorkers
from dcgrid_env.core.suggestions import unknown


@dataclass(frozen=True)
class TuneAgent(OverWorkers):
    """Search for an algorithm's best settings on a scenario.

    Scores each trial on the validation split and prints the best settings as TOML.

    Trials are kept in OUT. Run an interrupted search again to resume, or with a larger --trials to extend it. The
    printed settings have the format of agents/training/preset_settings.toml.
    """

    algorithm: tyro.conf.Positional[str]
    """Algorithm, one of those of dcgrid train."""
    scenario: str = "ieee33-weak"
    """Name of a preset."""
    trials: int = 20
    """Total number of trainings. The first one uses the default settings."""
    fixed: tuple[str, ...] = ()
    """Settings of the algorithm that stay fixed in all trials, for example --fixed steps=500000."""
    seed: int = 0
    """Seed of the search. The same seed gives the same trials."""
    batch: int = 1
    """Number of trials that are suggested together and can train in parallel. The result depends on it, but not on
    --workers or --ray."""
    out: Path | None = None
    """Folder of the search. Default: results/tune-agent/SCENARIO-ALGORITHM."""

    @property
    def resumes(self) -> str:
        """Message on how to resume; finished trials are kept."""
        return GOES_ON

    def run(self) -> None:
        """Search, print each trial and the best; raise ValueError first if a setting is invalid."""
        from dcgrid_env.agents.train_command import ALGORITHMS
        from dcgrid_env.agents.training.agent_search import (
            SECONDS,
            best_as_toml,
            ended,
            number_of,
            require_optuna,
            search,
            seconds,
        )
        from dcgrid_env.agents.training.search_spaces import SPACES

        require_optuna()
        if self.algorithm not in SPACES:
            there = f"choose from {', '.join(SPACES)}"
            if self.algorithm in ALGORITHMS:
                raise ValueError(f"algorithm: must have a search space, got {self.algorithm!r}; {there}")
            raise ValueError(unknown("algorithm", self.algorithm, SPACES, there))
        base = self._base()
        folder = self.out or Path("results/tune-agent") / f"{base.scenario}-{self.algorithm}"
        place, console = self.place, plain_console()
        if self.batch < min(self.trials, place.workers) and (self.workers or self.ray):
            say(
                console, f"only {self.batch} of {place.workers} workers are used: --batch limits the parallel trainings"
            )

        def shown(trial: Any) -> None:
            cost = "stopped" if trial.state.name == "PRUNED" else f"J {trial.value:.4f}"
            settings = ", ".join(
                f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}"
                for name, value in trial.params.items()
            )
            say(console, f"{number_of(trial)}: {cost}, {trial.user_attrs[SECONDS]:.0f} s: {settings}")

        with alone_in(folder, "dcgrid tune-agent"):
            study = search(base, self.trials, self.seed, folder, self._given(), shown, self.batch, place)
        trials = ended(study)
        stopped = sum(trial.state.name == "PRUNED" for trial in trials)
        if len(trials) == stopped:
            raise ValueError(f"all {stopped} trials were stopped early or diverged; see {folder}")
        say(
            console,
            f"best: trial {number_of(study.best_trial)}, J {study.best_value:.4f} on validation; {len(trials)} trials, "
            f"{stopped} of them stopped early, {seconds(study):.0f} s of training",
        )
        print(best_as_toml(study, base))

    def _given(self) -> dict[str, Any]:
        """Return the values of the fixed fields; raise ValueError if one cannot be parsed."""
        from dcgrid_env.baselines.scenario_spec import read_overrides

        given = read_overrides(self.fixed, "fixed")
        return {name: tuple(value) if isinstance(value, list) else value for name, value in given.items()}

    def _base(self) -> Any:
        """Return the configuration of all trials; raise ValueError if a field or value is invalid."""
        from pydantic import TypeAdapter, ValidationError

        from dcgrid_env.agents.train_command import ALGORITHMS
        from dcgrid_env.agents.training.config import check

        kind, given = ALGORITHMS[self.algorithm].configuration(), self._given()
        names = {field.name for field in dataclasses.fields(kind)} - {"scenario", "out", "resume"}
        hints = get_type_hints(kind)
        for name, value in given.items():
            if name not in names:
                listed = f"`dcgrid train {self.algorithm} --help` lists all"
                raise ValueError(f"fixed: {unknown(f'{self.algorithm} setting', name, names, listed)}")
            try:
                TypeAdapter(hints[name]).validate_python(value, strict=True)
            except ValidationError as error:
                remedy = error.errors()[0]["msg"]
                raise ValueError(f"fixed: {name}: invalid value {value!r}; {remedy[:1].lower()}{remedy[1:]}") from None
        base = kind.for_scenario(one_scenario(self.scenario), **given)
        check(base)
        return base
