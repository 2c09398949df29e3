"""The command ``dcgrid replay``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import tyro

from dcgrid_env.cli.command import Command
from dcgrid_env.cli.names import split_names
from dcgrid_env.cli.opening import offer
from dcgrid_env.cli.progress import progress_bar
from dcgrid_env.cli.settings import Overrides, at_least, check_file
from dcgrid_env.cli.stored_run import StoredRun, stored_run
from dcgrid_env.cli.terminal import plain_console, say

if TYPE_CHECKING:
    from dcgrid_env import Scenario, Series

COMPARED = "none,droop"
"""Controllers of a replay that names neither a run nor controllers."""
MOST_FPS = 100
"""Frames of a film a second at most: a gif counts in hundredths of a second."""


@dataclass(frozen=True)
class Replay(Command):
    """Show an episode in the browser, step by step.

    Writes one HTML file with maps, curves and a slider, which needs no server and no network.

    Episodes are run again, which gives the very same, as all that is drawn follows from the scenario and the seed.
    --gif and --mp4 write films instead.
    """

    run_folder: tyro.conf.Positional[Path | None] = None
    """Folder of dcgrid run whose first episode is replayed, under its controllers; or give --scenario."""
    scenario: str | None = None
    """Name of a scenario (dcgrid list), path/to/file.toml, or path/to/file.py:function or package.module:function that
    makes your own."""
    set: Overrides = ()
    """Fields of the scenario that are to be otherwise, for instance --set horizon=60."""
    compare: str | None = None
    """Controllers side by side, separated by commas, as dcgrid run --controllers takes them; the run's own unless
    given, and none,droop with --scenario."""
    seed: int | None = None
    """The episode; the first of the run, or 0."""
    split: str = "test"
    """What the seed means with --scenario: train, validation, test or ood."""
    tuned: Path | None = None
    """File of dcgrid tune that the gains of tuned controllers must come from; see dcgrid run."""
    trust: bool = False
    """Run code of somebody's own that the folder's run names (file.py:Class); without it such a run is refused."""
    out: Path | None = None
    """File of the page; replay.html in the run's folder unless given, or in results/replay."""
    gif: Path | None = None
    """File of an animated gif to write instead of a page."""
    mp4: Path | None = None
    """File of an mp4 to write instead of a page."""
    fps: float = 10.0
    """Frames of a film a second."""
    every: int = 1
    """Steps from one frame of a film to the next."""
    open: bool = False
    """Open what was written."""

    def run(self) -> None:
        """Run the episode again and write. ValueError for an invalid setting, before anything is run."""
        from dcgrid_env.baselines import find_controller
        from dcgrid_env.baselines.tuning.tuned import require_tuned
        from dcgrid_env.rendering import replay

        at_least(self, every=1, fps=0.1)
        asked = _asked(self)
        require_tuned(asked.tuned)
        targets = [path for path in (self.gif, self.mp4) if path is not None]
        page = self.out or (self.run_folder or Path("results/replay")) / "replay.html"
        _check(self, asked, targets)
        for field, path in (("gif", self.gif), ("mp4", self.mp4), ("out", None if targets else page)):
            if path is not None:
                check_file(field, path)
        controllers = {name: find_controller(name, asked.scenario, asked.tuned) for name in asked.names}
        console, runs, notes = plain_console(), {}, []
        with progress_bar(console) as progress:
            for name, controller in controllers.items():
                bar = progress.add_task(name, total=asked.scenario.horizon)
                runs[name] = _episode(asked, name, controller, lambda bar=bar: progress.advance(bar))
                if asked.stored is not None and (said := asked.stored.difference(name, asked.seed, _cost(runs[name]))):
                    notes.append(said)
            for target in targets:
                _film(self, target, runs, progress)
        for line in notes:
            say(console, line)
        if not targets:
            first = asked.scenario
            replay(runs, f"{first.name}, {first.split} split, seed {asked.seed}").write(page)
            targets = [page]
        for target in targets:
            say(console, f"wrote {target} ({target.stat().st_size / 1e6:.1f} MB)")
        offer(console, targets[0], self.open)


class _Asked(NamedTuple):
    scenario: Scenario
    names: list[str]
    seed: int
    tuned: Path | None
    stored: StoredRun | None


def _asked(cfg: Replay) -> _Asked:
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec

    if (cfg.run_folder is None) == (cfg.scenario is None):
        raise ValueError("give the folder of a run, such as results/run, or --scenario; one of them")
    if cfg.scenario is not None:
        names = split_names(cfg.compare or COMPARED)
        return _Asked(ScenarioSpec(cfg.scenario, cfg.set).make(cfg.split), names, cfg.seed or 0, cfg.tuned, None)
    if cfg.set or cfg.split != "test":
        raise ValueError("set and split are those of the run; leave them out, or give --scenario without a folder")
    stored = stored_run(cfg.run_folder or Path(), cfg.trust)
    command = stored.command
    names = split_names(cfg.compare) if cfg.compare is not None else stored.controllers
    seed = command.seed if cfg.seed is None else cfg.seed
    return _Asked(stored.scenario, names, seed, cfg.tuned or command.tuned, stored)


def _check(cfg: Replay, asked: _Asked, films: list[Path]) -> None:
    """ValueError for what cannot be replayed, before anything is run."""
    from dcgrid_env.rendering.film import require_imageio
    from dcgrid_env.rendering.replay_page import check_size, plotting_script

    if asked.seed < 0:
        raise ValueError(f"seed is {asked.seed}; give at least 0")
    if not asked.names:
        raise ValueError(f"compare is {cfg.compare!r}; name at least one controller (dcgrid list)")
    check_size(asked.scenario.member(asked.seed), len(asked.names))
    if films and cfg.out is not None:
        raise ValueError("out is the page's file; give it without --gif and --mp4")
    if cfg.fps > MOST_FPS:
        raise ValueError(f"fps is {cfg.fps:g}; give at most {MOST_FPS}")
    for option, path in (("gif", cfg.gif), ("mp4", cfg.mp4)):
        if path is not None and path.suffix != f".{option}":
            raise ValueError(f"{option} is {str(path)!r}; give a file that ends in .{option}")
    for path in films:
        require_imageio(path)
    if not films:
        plotting_script()


def _episode(asked: _Asked, name: str, controller: Any, on_step: Callable[[], None]) -> Series:
    from dcgrid_env.baselines import rollout

    return rollout(asked.scenario, controller, [asked.seed], on_step, name).lane(0)


def _cost(run: Series) -> float:
    return float(run.cost_j.sum() / run.scenario.horizon)


def _film(cfg: Replay, path: Path, runs: dict[str, Series], progress: Any) -> None:
    from dcgrid_env.rendering.film import write_film

    steps = max(len(run.v_pu) for run in runs.values()) - 1
    bar = progress.add_task(path.name, total=-(-steps // cfg.every) + 1)
    write_film(path, runs, cfg.fps, cfg.every, lambda: progress.advance(bar))
