"""The command ``dcgrid dev sags``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from dcgrid_env.cli.names import one_scenario, split_names
from dcgrid_env.cli.settings import check_folder
from dcgrid_env.cli.terminal import plain_console, say, working
from dcgrid_env.cli.workers import OverWorkers
from dcgrid_env.core.versions import meta


@dataclass(frozen=True)
class Sags(OverWorkers):
    """Compare controllers during a recorded sequence of sags.

    Shows which sites disconnect, how high the voltage rises and how long until all have reconnected.
    """

    scenario: str = "ride-through"
    """Name of a preset with sags and sites that leave (dcgrid list)."""
    controllers: str = "none,return-by-hand,staggered-return,staggered-return-tuned,ride-through-analytic"
    """Controllers separated by commas, a column of the figure each; the best known stands behind them where it is
    known of all episodes."""
    beside: str = "droop-tuned,ride-through-ppo"
    """Controllers that are only in the table, separated by commas; empty for none."""
    episodes: int = 32
    """Number of test episodes: seeds 0, 1, .."""
    seed: int = 1
    """The episode that is drawn."""
    out: Path = Path("results/sags")
    """Folder for sag-study.md and images/sag-study.png."""

    def run(self) -> None:
        """Drive, draw, write. ValueError for a setting that cannot be."""
        from dcgrid_env import make_scenario
        from dcgrid_env.agents.studies.sag_figure import sag_figure
        from dcgrid_env.agents.studies.sag_study import markdown, sag_study, table
        from dcgrid_env.baselines.hindsight_costs import published
        from dcgrid_env.baselines.score import SPLIT
        from dcgrid_env.core.files import write_figure, write_text

        if self.episodes < 1:
            raise ValueError(f"episodes is {self.episodes}; give at least 1")
        place, name, console = self.place, one_scenario(self.scenario), plain_console()
        check_folder(self.out / "images")
        test = make_scenario(name, split=SPLIT)
        known = published(test)
        every = known is not None and known.is_best_known and not known.missing(range(self.episodes))
        with working(console, f"{self.episodes} test episodes of {name}"):
            beside = split_names(self.beside)
            study = sag_study(name, [*split_names(self.controllers), *beside], self.episodes, self.seed, every, place)
        drawn = replace(study, driven=tuple(one for one in study.driven if one.name not in beside))
        write_figure(self.out / "images" / "sag-study.png", sag_figure(drawn), dpi=110)
        write_text(self.out / "sag-study.md", markdown(study, meta()["command"], "images/sag-study.png"))
        console.print(table(study).rich(console.width))
        say(console, f"wrote {self.out / 'sag-study.md'} and {self.out / 'images' / 'sag-study.png'}")
