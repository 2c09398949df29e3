"""The command ``dcgrid reproduce``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from dcgrid_env.core.commands.progress import progress_bar
from dcgrid_env.core.commands.settings import check_folder
from dcgrid_env.core.commands.terminal import plain_console, say
from dcgrid_env.core.commands.workers import OverWorkers
from dcgrid_env.core.files import write_json, write_text
from dcgrid_env.core.versions import meta

if TYPE_CHECKING:
    from rich.console import Console

    from dcgrid_env.apps.reproduction.study_runs import Setting

HEAD = ("claim", "paper", "ours", "verdict")
"""Columns of the claims on the terminal."""


@dataclass(frozen=True)
class Reproduce(OverWorkers):
    """Repeat the paper's study (Chen and Zhang, arXiv 2507.06416).

    Compares the paper's Table I and its claims with the results of this package, on the balanced equivalent of its
    feeder (ieee123). With the recorded load, a run takes about half a minute.
    """

    out: Path = Path("results/reproduce")
    """Folder for reproduction.md and reproduction.json. Created if missing."""
    episodes: int = 20
    """Number of episodes for each table cell, at least 2."""
    trace: str = "auto"
    """Load: auto (the paper's recording if it was fetched, otherwise the generator), recorded, generated, the name of a
    generator or recording (dcgrid list), or a file."""
    placement: Literal["random", "published"] = "random"
    """Location of the data centres: random, or the buses of the paper's public code."""

    def run(self) -> None:
        """Run the study and write the results; raise ValueError before writing if a setting is invalid."""
        from dcgrid_env.apps.reproduction.markdown import render
        from dcgrid_env.apps.reproduction.study import PARTS, study
        from dcgrid_env.apps.reproduction.study_runs import Runs

        setting, about = self.setting()
        place, console = self.place, plain_console()
        check_folder(self.out)
        with steps(console, len(PARTS)) as done:
            records = about | study(Runs(setting), lambda part: done(part.replace("_", " ")), place)
        print_rows(console, HEAD, [[row[key] for key in HEAD] for row in records["claims"]])
        self.write(console, "reproduction", records, render(records))

    def setting(self) -> tuple[Setting, dict[str, Any]]:
        """Return the study's setting, and the part of its records that states command, versions and load.

        Raises ValueError if a setting is invalid, and TraceError if a recording is shorter than an episode.
        """
        from dcgrid_env.apps.reproduction.load import choose_load
        from dcgrid_env.apps.reproduction.study_runs import Setting
        from dcgrid_env.engine.exogenous.trace_pool import trace_pool

        setting = Setting(choose_load(self.trace), self.episodes, self.placement)
        return setting, {"meta": meta() | {"trace": trace_pool(setting.scenario(5)).provenance[0].record()}}

    def write(self, console: Console, name: str, records: dict[str, Any], page: str) -> None:
        """Write the records as JSON and the page, and print where they are."""
        write_json(self.out / f"{name}.json", records)
        write_text(self.out / f"{name}.md", page)
        say(console, f"load: {records['setting']['load_description']}\nwrote {self.out / f'{name}.md'}")


@contextmanager
def steps(console: Console, total: int) -> Iterator[Callable[[str], None]]:
    """Show a progress bar; call the yielded function with the name of each finished step."""
    with progress_bar(console) as progress:
        bar = progress.add_task("", total=total)
        yield lambda step: progress.update(bar, advance=1, description=step)


def print_rows(console: Console, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table with lines between its rows."""
    from rich import box
    from rich.table import Table

    table = Table(*head, header_style="bold", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_lines=True)
    for row in rows:
        table.add_row(*row)
    console.print(table)
