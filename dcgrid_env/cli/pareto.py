"""The command ``dcgrid dev pareto``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dcgrid_env.cli.command import GOES_ON, Command
from dcgrid_env.cli.names import scenario_names
from dcgrid_env.cli.settings import check_folder
from dcgrid_env.cli.terminal import plain_console, say, working
from dcgrid_env.core.versions import meta


@dataclass(frozen=True)
class Pareto(Command):
    """Train policies under limits on mean delay and draw voltage against delay, over the droop law's own curve.

    Trainings are kept in RUNS: an interrupted command goes on where it was, and what is done is not done again.
    """

    scenario: str = "ieee33-weak"
    """Name of a scenario (dcgrid list)."""
    delays: str = "0.25,0.5,1,2,4,8"
    """Limits on mean delay, s, separated by commas."""
    updates: int | None = None
    """Steps of the optimiser of each training; the algorithm's own default unless given."""
    seeds: int = 1
    """Training seeds of each limit: 0, 1, .."""
    episodes: int = 100
    """Test episodes: seeds 0, 1, ..; at least 2, at most the published 100."""
    jobs: int | None = None
    """Trainings at once; by default one for each core."""
    runs: Path = Path("results/pareto")
    """Folder of the training runs."""
    out: Path = Path("results/pareto")
    """Folder for pareto.md and images/pareto.png."""

    @property
    def resumes(self) -> str:
        """How to go on: what has been kept is not done again."""
        return GOES_ON

    def run(self) -> None:
        """Train, test, draw, write. ValueError for a setting that cannot be, before anything is trained."""
        from dcgrid_env.agents.studies import pareto
        from dcgrid_env.agents.studies.learning_figures import pareto_figure
        from dcgrid_env.agents.studies.learning_tables import brief
        from dcgrid_env.cli import trainings
        from dcgrid_env.cli.train import ALGORITHMS
        from dcgrid_env.core.files import write_figure, write_text

        scenario = scenario_names(self.scenario)
        if len(scenario) > 1:
            raise ValueError(f"scenario is {self.scenario!r}; give one")
        limits_s = trainings.positive_numbers("delays", self.delays)
        chosen = trainings.chosen(self.updates, self.seeds, self.episodes)
        configs = pareto.configs(
            ALGORITHMS["analytic"].configuration(), scenario[0], limits_s, chosen, self.seeds, self.runs
        )
        check_folder(self.out / "images")
        console = plain_console()
        failures = trainings.do(configs, self.jobs, console)
        if failures:
            raise ValueError(f"{len(failures)} of {len(configs)} trainings failed: {next(iter(failures.values()))}")
        with working(console, f"{self.episodes} test episodes of {scenario[0]}"):
            front = pareto.front(scenario[0], self.episodes, configs)
        write_figure(self.out / "images" / "pareto.png", pareto_figure(front), dpi=130)
        write_text(self.out / "pareto.md", pareto.markdown(front, meta()["command"], "images/pareto.png"))
        console.print(brief(pareto.learned_table(front), "J", "J but for waiting", "mean delay, s").rich(console.width))
        say(console, f"wrote {self.out / 'pareto.md'} and {self.out / 'images' / 'pareto.png'}")
