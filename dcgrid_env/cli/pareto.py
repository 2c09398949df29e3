"""The command ``dcgrid dev pareto``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dcgrid_env.cli.names import one_scenario
from dcgrid_env.cli.settings import check_folder
from dcgrid_env.cli.terminal import plain_console, say, working
from dcgrid_env.cli.trainings import Study, do_trainings, positive_numbers
from dcgrid_env.core.versions import meta


@dataclass(frozen=True)
class Pareto(Study):
    """Draw voltage against delay of policies with delay limits.

    Trains policies under limits on the mean delay and draws them over the droop law's own curve.

    Trainings are kept in RUNS: an interrupted command goes on where it was, and what is done is not done again.
    """

    scenario: str = "ieee33-weak"
    """Name of a scenario (dcgrid list)."""
    delays: str = "0.25,0.5,1,2,4,8"
    """Limits on mean delay, s, separated by commas."""
    runs: Path = Path("results/pareto")
    """Folder of the training runs."""
    out: Path = Path("results/pareto")
    """Folder for pareto.md and images/pareto.png."""

    def run(self) -> None:
        """Train, test, draw, write. ValueError for a setting that cannot be, before anything is trained."""
        from dcgrid_env.agents.studies import pareto
        from dcgrid_env.agents.studies.learning_figures import pareto_figure
        from dcgrid_env.agents.studies.learning_tables import brief
        from dcgrid_env.cli.train import ALGORITHMS
        from dcgrid_env.core.files import write_figure, write_text

        scenario = one_scenario(self.scenario)
        limits_s = positive_numbers("delays", self.delays)
        chosen = self.settings()
        configs = pareto.configs(
            ALGORITHMS["analytic"].configuration(), scenario, limits_s, chosen, self.seeds, self.runs
        )
        check_folder(self.out / "images")
        console = plain_console()
        failures = do_trainings(configs, self.place, console)
        if failures:
            raise ValueError(f"{len(failures)} of {len(configs)} trainings failed: {next(iter(failures.values()))}")
        with working(console, f"{self.episodes} test episodes of {scenario}"):
            front = pareto.front(scenario, self.episodes, configs)
        write_figure(self.out / "images" / "pareto.png", pareto_figure(front), dpi=130)
        write_text(self.out / "pareto.md", pareto.markdown(front, meta()["command"], "images/pareto.png"))
        console.print(brief(pareto.learned_table(front), "J", "J but for waiting", "mean delay, s").rich(console.width))
        say(console, f"wrote {self.out / 'pareto.md'} and {self.out / 'images' / 'pareto.png'}")
