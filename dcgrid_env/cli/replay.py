"""The command ``dcgrid replay``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import tyro

from dcgrid_env.cli.stored_run import StoredRun, stored_run
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.names import split_names
from dcgrid_env.core.commands.opening import offer
from dcgrid_env.core.commands.progress import progress_bar
from dcgrid_env.core.commands.settings import Overrides, check_file
from dcgrid_env.core.commands.terminal import plain_console, say

if TYPE_CHECKING:
    from dcgrid_env import Scenario, Series
    from dcgrid_env.baselines.controller import Controller

COMPARED = "none,droop"
"""Default controllers with ``--scenario``."""


@dataclass(frozen=True)
class Replay(Command):
    """Show an episode in the browser, step by step.

    Writes one HTML file with maps, curves and a slider. It works offline and without a server.

    The command simulates the episode again; the result is the same, because it depends only on scenario and seed.
    --gif and --mp4 write animations instead.
    """

    run_folder: tyro.conf.Positional[Path | None] = None
    """Output folder of dcgrid run. Replays its first episode under its controllers. Omit it to use --scenario."""
    scenario: str | None = None
    """Scenario to replay instead of a run: a name (dcgrid list), path/to/file.toml, path/to/file.py:function or
    package.module:function."""
    set: Overrides = ()
    """Fields of --scenario to override, for example --set horizon=60."""
    compare: str | None = None
    """Controllers to show side by side, separated by commas, as for dcgrid run --controllers. Default: those of the
    run, or none,droop with --scenario."""
    seed: int | None = None
    """Seed of the episode. Default: the first seed of the run, or 0 with --scenario."""
    split: str | None = None
    """Split of the episode with --scenario: train, validation, test, ood or whole. Default: as for dcgrid run."""
    tuned: Path | None = None
    """File with the gains of the tuned controllers, written by dcgrid tune. Default: as for dcgrid run."""
    trust: bool = False
    """Allow replaying a run that names code (file.py:Class), which executes that code."""
    out: Path | None = None
    """HTML file to write. Default: replay.html in the run's folder, or in results/replay with --scenario."""
    gif: Path | None = None
    """GIF file to write instead of the HTML page."""
    mp4: Path | None = None
    """MP4 file to write instead of the HTML page."""
    fps: float = 10.0
    """Frame rate of the animation, 1/s."""
    every: int = 1
    """Number of simulation steps per frame of the animation."""
    open: bool = False
    """Open the file when the command ends."""

    def run(self) -> None:
        """Run the episode again and write; raise ValueError before any run if a setting is invalid."""
        from dcgrid_env.baselines import find_controller
        from dcgrid_env.baselines.tuning.tuned import require_tuned
        from dcgrid_env.rendering import replay

        request = _request(self)
        require_tuned(request.tuned)
        targets = [path for path in (self.gif, self.mp4) if path is not None]
        page = self.out or (self.run_folder or Path("results/replay")) / "replay.html"
        _check(self, request, targets)
        for field, path in (("gif", self.gif), ("mp4", self.mp4), ("out", None if targets else page)):
            if path is not None:
                check_file(field, path)
        controllers = {name: find_controller(name, request.scenario, request.tuned) for name in request.names}
        console, runs, notes = plain_console(), {}, []
        with progress_bar(console) as progress:
            for name, controller in controllers.items():
                bar = progress.add_task(name, total=request.scenario.horizon)
                runs[name] = _episode(request, name, controller, lambda bar=bar: progress.advance(bar))
                if request.stored is not None and (
                    said := request.stored.difference(name, request.seed, _cost(runs[name]))
                ):
                    notes.append(said)
            for target in targets:
                _film(self, target, runs, progress)
        for line in notes:
            say(console, line)
        if not targets:
            first = request.scenario
            replay(runs, f"{first.name}, {first.split} split, seed {request.seed}").write(page)
            targets = [page]
        for target in targets:
            say(console, f"wrote {target} ({target.stat().st_size / 1e6:.1f} MB)")
        offer(console, targets[0], self.open)


class _Request(NamedTuple):
    scenario: Scenario
    names: list[str]
    seed: int
    tuned: Path | None
    stored: StoredRun | None


def _request(cfg: Replay) -> _Request:
    from dcgrid_env.baselines.engineering import engineering_scenario
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec

    if (cfg.run_folder is None) == (cfg.scenario is None):
        raise ValueError(
            "run-folder: must be given, or --scenario, but not both; give the folder of a run, such as results/run"
        )
    if cfg.scenario is not None:
        names = split_names(cfg.compare or COMPARED)
        make = ScenarioSpec(cfg.scenario, cfg.set).make
        scenario = engineering_scenario(make) if cfg.split is None else make(cfg.split)
        return _Request(scenario, names, cfg.seed or 0, cfg.tuned, None)
    if cfg.set or cfg.split is not None:
        raise ValueError(
            "set, split: must not be given with a run's folder, which defines them; remove them, or use --scenario"
        )
    stored = stored_run(cfg.run_folder or Path(), cfg.trust)
    command = stored.command
    names = split_names(cfg.compare) if cfg.compare is not None else stored.controllers
    seed = command.seed if cfg.seed is None else cfg.seed
    return _Request(stored.scenario, names, seed, cfg.tuned or command.tuned, stored)


def _check(cfg: Replay, request: _Request, films: list[Path]) -> None:
    """Raise ValueError before any run if the replay is not possible."""
    from dcgrid_env.rendering.film import require_imageio
    from dcgrid_env.rendering.replay_page import check_size, plotting_script

    if not request.names:
        raise ValueError(f"compare: must name at least one controller (dcgrid list), got {cfg.compare!r}")
    check_size(request.scenario.member(request.seed), len(request.names))
    if films and cfg.out is not None:
        raise ValueError("out: must not be combined with --gif or --mp4, as it is the HTML file; remove --out")
    for option, path in (("gif", cfg.gif), ("mp4", cfg.mp4)):
        if path is not None and path.suffix != f".{option}":
            raise ValueError(f"{option}: must end in .{option}, got {str(path)!r}")
    for path in films:
        require_imageio(path)
    if not films:
        plotting_script()


def _episode(request: _Request, name: str, controller: Controller, on_step: Callable[[], None]) -> Series:
    from dcgrid_env.baselines import rollout

    return rollout(request.scenario, controller, [request.seed], on_step, name).series(0)


def _cost(run: Series) -> float:
    return float(run.cost_j.sum() / run.scenario.horizon)


def _film(cfg: Replay, path: Path, runs: dict[str, Series], progress: Any) -> None:
    from dcgrid_env.rendering.film import write_film

    steps = max(len(run.v_pu) for run in runs.values()) - 1
    bar = progress.add_task(path.name, total=-(-steps // cfg.every) + 1)
    write_film(path, runs, cfg.fps, cfg.every, lambda: progress.advance(bar))
