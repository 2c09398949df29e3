"""The command ``dcgrid reproduce``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from dcgrid_env.cli.command import Command
from dcgrid_env.cli.progress import progress_bar
from dcgrid_env.cli.settings import check_folder
from dcgrid_env.cli.terminal import plain_console, say
from dcgrid_env.core.files import write_json
from dcgrid_env.core.versions import meta

if TYPE_CHECKING:
    from rich.table import Table

    from dcgrid_env.baselines.reproduction.study_runs import Runs


@dataclass(frozen=True)
class Reproduce(Command):
    """Repeat the paper's study (Chen and Zhang, arXiv 2507.06416).

    Its tables, figures and claims are shown beside what comes out here.
    """

    out: Path = Path("results/reproduce")
    """Folder for reproduction.md, reproduction.json and images; made if it is not there."""
    episodes: int = 20
    """Episodes for each cell, at least 2."""
    trace: str = "auto"
    """Load: auto (the paper's recording if it has been fetched, else the generator), recorded, generated, or the name
    of a generator or recording, or a file."""
    placement: Literal["random", "published"] = "random"
    """Data centres at random, or at the buses named in the paper's public code."""

    def run(self) -> None:
        """Run the study, write it down. ValueError for a setting that cannot be, before anything is written."""
        from dcgrid_env.baselines.reproduction.load import choose_load
        from dcgrid_env.baselines.reproduction.markdown import render
        from dcgrid_env.baselines.reproduction.paper_figures import draw_all
        from dcgrid_env.baselines.reproduction.study import PARTS, study
        from dcgrid_env.baselines.reproduction.study_runs import Runs, Setting
        from dcgrid_env.core.files import write_text

        runs = Runs(Setting(choose_load(self.trace), self.episodes, self.placement))
        records: dict[str, Any] = {"meta": meta() | {"trace": _origin(runs)}}
        check_folder(self.out)
        console = plain_console()
        with progress_bar(console) as progress:
            bar = progress.add_task("", total=len(PARTS) + 1)
            begun = 0

            def begin(part: str) -> None:
                nonlocal begun
                progress.update(bar, completed=begun, description=part.replace("_", " "))
                begun += 1

            records |= study(runs, begin)
            begin("figures")
            records["figures"] = draw_all(runs, self.out)
            progress.advance(bar)
        write_json(self.out / "reproduction.json", records)
        write_text(self.out / "reproduction.md", render(records))
        console.print(_claims(records["claims"]))
        say(console, f"load: {runs.setting.load.description}\nwrote {self.out / 'reproduction.md'}")


def _claims(rows: list[dict[str, str]]) -> Table:
    """The claims for the terminal."""
    from rich import box
    from rich.table import Table

    table = Table(header_style="bold", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_lines=True)
    for heading in ("claim", "paper", "ours", "verdict"):
        table.add_column(heading)
    for row in rows:
        table.add_row(row["claim"], row["paper"], row["ours"], row["verdict"])
    return table


def _origin(runs: Runs) -> dict[str, Any]:
    """Where the load comes from: parameters and seed of the first generated row, or hash, licence and citation.

    TraceError for a recording that is too short for an episode.
    """
    from dcgrid_env.engine.trace_pool import trace_pool

    return trace_pool(runs.setting.scenario(5)).provenance[0].record()
