"""The command ``dcgrid dev generalise``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dcgrid_env.cli.names import scenario_names
from dcgrid_env.cli.settings import check_folder
from dcgrid_env.cli.terminal import plain_console, say, working
from dcgrid_env.cli.trainings import Study, do_trainings
from dcgrid_env.core.versions import meta


@dataclass(frozen=True)
class Generalise(Study):
    """Train on all scenarios but one and score on that one.

    Trainings are kept in RUNS: an interrupted command goes on where it was, and what is done is not done again.
    """

    scenarios: str = "ieee33,das69,khodr141,ieee123"
    """Names of scenarios, at least two, separated by commas (dcgrid list)."""
    vary: int = 6
    """Variants of each scenario to train on: other places, ratings and substation voltages."""
    runs: Path = Path("results/generalise")
    """Folder of the training runs."""
    out: Path = Path("results/generalise")
    """Folder for generalise.md."""

    def run(self) -> None:
        """Train, test, write. ValueError for a setting that cannot be, before anything is trained."""
        from dcgrid_env.agents.studies import generalise
        from dcgrid_env.agents.studies.learning_tables import brief
        from dcgrid_env.cli.train import ALGORITHMS
        from dcgrid_env.core.files import write_text

        scenarios = scenario_names(self.scenarios)
        if len(scenarios) < 2:
            raise ValueError(f"scenarios is {self.scenarios!r}; give at least two, one is left out")
        if self.vary < 0:
            raise ValueError(f"vary is {self.vary}; give at least 0")
        chosen = self.settings(vary=self.vary)
        runs = generalise.configs(ALGORITHMS["analytic"].configuration(), scenarios, chosen, self.seeds, self.runs)
        check_folder(self.out)
        console = plain_console()
        failures = do_trainings((config for every in runs.values() for config in every), self.place, console)
        with working(console, f"{self.episodes} test episodes of each scenario"):
            results = generalise.generalise(self.episodes, runs, failures)
            table = generalise.table(self.episodes, results)
        console.print(
            brief(table, "score there", "trained there", "best static rule", "mean delay, s").rich(console.width)
        )
        write_text(self.out / "generalise.md", generalise.markdown(results, table, meta()["command"]))
        say(console, f"wrote {self.out / 'generalise.md'}")
