"""The command ``dcgrid dev unseen-feeders``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dcgrid_env.cli.names import scenario_names, split_names
from dcgrid_env.cli.progress import progress_bar
from dcgrid_env.cli.settings import at_least, check_folder
from dcgrid_env.cli.terminal import plain_console, say
from dcgrid_env.cli.trainings import MOST_EPISODES
from dcgrid_env.cli.workers import OverWorkers
from dcgrid_env.core.versions import meta

if TYPE_CHECKING:
    from rich.console import Console

    from dcgrid_env.agents.studies.learning_tables import Table
    from dcgrid_env.core.work.unit import Place


@dataclass(frozen=True)
class UnseenFeeders(OverWorkers):
    """Score controllers on feeders they never saw.

    Scores policies too, on named feeders and on each random one of zero-shot.
    """

    controllers: str = "model-aided"
    """Names of controllers, or files of policies, separated by commas."""
    scenarios: str = "ieee33,ieee123,das69,khodr141,ieee33-weak,mixed,toy6,sync,bursty,training,robust,zero-shot"
    """Names of scenarios, separated by commas (dcgrid list)."""
    split: str = "test"
    """Split of the episodes; those of --episodes have a score on test alone."""
    episodes: int = 100
    """Episodes: seeds 0, 1, ..; at least 2, at most the published 100."""
    each: int = 0
    """Episodes of each random feeder, its own seeds 0, 1, .., by which it is scored in a table of its own; their
    hindsight is solved on the way, about a second an episode. None for 0."""
    worst: int = 5
    """How many of the worst random feeders to show."""
    out: Path | None = None
    """Folder for unseen-feeders.md; nothing is written unless given."""

    def run(self) -> None:
        """Drive, score, print. ValueError for a setting that cannot be, before anything is run."""
        from dcgrid_env.agents.studies import unseen_feeders

        names, scenarios = split_names(self.controllers), scenario_names(self.scenarios)
        if not names:
            raise ValueError("controllers is empty; name at least one")
        if not 2 <= self.episodes <= MOST_EPISODES:
            raise ValueError(f"episodes is {self.episodes}; give 2 to {MOST_EPISODES}, the published test episodes")
        at_least(self, worst=1, each=0)
        if self.out is not None:
            check_folder(self.out)
        unseen_feeders.require_found(names, scenarios, self.split)
        families = self._families(scenarios)
        place, console, results = self.place, plain_console(), []
        with progress_bar(console) as progress:
            bar = progress.add_task("scenarios", total=len(scenarios))
            for one in unseen_feeders.tried(names, scenarios, self.split, self.episodes, place):
                results.append(one)
                progress.advance(bar)
        shown = unseen_feeders.scores_table(results, self.episodes)
        of_feeders = [table for one in results if (table := unseen_feeders.feeders_table(one, self.worst)) is not None]
        for table in (shown, *of_feeders):
            console.print(table.rich(console.width))
        for line in (line for one in results for line in one.refusals.values()):
            say(console, line)
        for one in (one for one in results if one.scenario.name in families):
            if driving := [name for name in names if name not in one.refusals]:
                of_feeders.append(self._each(driving, one.scenario.name, place, console))
                console.print(of_feeders[-1].rich(console.width))
        if self.out is not None:
            from dcgrid_env.core.files import write_text

            write_text(self.out / "unseen-feeders.md", unseen_feeders.markdown(shown, of_feeders, meta()["command"]))
            say(console, f"wrote {self.out / 'unseen-feeders.md'}")

    def _families(self, scenarios: list[str]) -> list[str]:
        """Those whose feeders are driven one by one; ValueError where it is asked for and there are none."""
        from dcgrid_env import RandomFeeders, make_scenario

        if not self.each:
            return []
        families = [name for name in scenarios if isinstance(make_scenario(name).feeder, RandomFeeders)]
        if not families:
            raise ValueError(
                f"each is {self.each}; none of {', '.join(scenarios)} is on random feeders: name zero-shot"
            )
        return families

    def _each(self, names: list[str], family: str, place: Place, console: Console) -> Table:
        """Drive the feeders of a family one by one; the table of their scores."""
        from dcgrid_env.agents.studies.feeder_by_feeder import on_each_feeder
        from dcgrid_env.agents.studies.unseen_feeders import each_table

        with progress_bar(console) as progress:
            bar = progress.add_task("feeders", total=None)
            begun = lambda n: progress.update(bar, total=n)  # noqa: E731
            done = lambda: progress.advance(bar)  # noqa: E731
            driven = on_each_feeder(names, family, self.split, self.episodes, self.each, place, begun, done)
        return each_table(family, names, driven, self.each, self.worst)
