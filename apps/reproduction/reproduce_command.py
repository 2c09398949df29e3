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
from dcgrid_env.core.files import write_json
from dcgrid_env.core.versions import meta

if TYPE_CHECKING:
    from rich.console import Console

    from dcgrid_env.apps.reproduction.study_runs import Setting
    from dcgrid_env.core.work.unit import Place


@dataclass(frozen=True)
class Reproduce(OverWorkers):
    """Repeat the paper's study (Chen and Zhang, arXiv 2507.06416).

    Compares the paper's tables, figures and claims with the results of this package. With the recorded load, a run
    takes about half a minute; with --scenario ieee123-3ph-published, about five minutes.
    """

    scenario: str = "ieee123"
    """Scenario: ieee123, the balanced equivalent of the paper's feeder, or ieee123-3ph-published, which compares
    Table I and the claims on the three-phase feeder, with fixed and active regulators, with the balanced results."""
    out: Path = Path("results/reproduce")
    """Folder for reproduction.md, reproduction.json and images, or reproduction-3ph.md and reproduction-3ph.json.
    Created if missing."""
    episodes: int = 20
    """Number of episodes for each table cell, at least 2."""
    trace: str = "auto"
    """Load: auto (the paper's recording if it was fetched, otherwise the generator), recorded, generated, the name of a
    generator or recording (dcgrid list), or a file."""
    placement: Literal["random", "published"] = "random"
    """Location of the data centres: random, or the buses of the paper's public code (with ieee123-3ph-published, those
    with three phases)."""

    def run(self) -> None:
        """Run the study and write the results; raise ValueError before writing if a setting is invalid."""
        from dcgrid_env.apps.reproduction.feeder_cases import TRUE, check_scenario
        from dcgrid_env.apps.reproduction.load import choose_load
        from dcgrid_env.apps.reproduction.study_runs import Setting
        from dcgrid_env.core.files import write_text

        check_scenario(self.scenario)
        setting = Setting(choose_load(self.trace), self.episodes, self.placement)
        about: dict[str, Any] = {"meta": meta() | {"trace": _origin(setting)}}
        place, console = self.place, plain_console()
        check_folder(self.out)
        name, make = ("reproduction-3ph", _compared) if self.scenario == TRUE else ("reproduction", _study)
        records, render = make(setting, self.out, console, place)
        records = about | records
        write_json(self.out / f"{name}.json", records)
        write_text(self.out / f"{name}.md", render(records))
        say(console, f"load: {setting.load.description}\nwrote {self.out / f'{name}.md'}")


Rendered = tuple[dict[str, Any], Callable[[dict[str, Any]], str]]
"""Records of a study, and the function that renders them as Markdown."""


def _study(setting: Setting, out: Path, console: Console, place: Place) -> Rendered:
    """Run the study on the balanced equivalent, with its figures."""
    from dcgrid_env.apps.reproduction.markdown import render
    from dcgrid_env.apps.reproduction.paper_figures import draw_all
    from dcgrid_env.apps.reproduction.study import PARTS, study
    from dcgrid_env.apps.reproduction.study_runs import Runs

    runs, head = Runs(setting), ("claim", "paper", "ours", "verdict")
    with _steps(console, len(PARTS) + 1) as done:
        records = study(runs, lambda part: done(part.replace("_", " ")), place)
        records["figures"] = draw_all(runs, out)
        done("figures")
    _print_rows(console, head, [[row[key] for key in head] for row in records["claims"]])
    return records, render


def _compared(setting: Setting, out: Path, console: Console, place: Place) -> Rendered:
    """Run the study on the three-phase feeder and on the balanced equivalent."""
    from dcgrid_env.apps.reproduction import feeder_comparison_markdown as written
    from dcgrid_env.apps.reproduction.feeder_cases import cases
    from dcgrid_env.apps.reproduction.feeder_comparison import PARTS, compare_feeders

    with _steps(console, len(PARTS) * len(cases())) as done:
        records = compare_feeders(setting, done, place)
    shown = {written.causes_table: 6, written.table_one_table: 6, written.orders_table: 7, written.claims_table: 6}
    for make, n in shown.items():
        head, rows = make(records)
        _print_rows(console, head[:n], [row[:n] for row in rows])
    return records, written.render_comparison


@contextmanager
def _steps(console: Console, total: int) -> Iterator[Callable[[str], None]]:
    """Show a progress bar; call the yielded function with the name of each finished step."""
    with progress_bar(console) as progress:
        bar = progress.add_task("", total=total)
        yield lambda step: progress.update(bar, advance=1, description=step)


def _print_rows(console: Console, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table with lines between its rows."""
    from rich import box
    from rich.table import Table

    table = Table(*head, header_style="bold", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_lines=True)
    for row in rows:
        table.add_row(*row)
    console.print(table)


def _origin(setting: Setting) -> dict[str, Any]:
    """Return the source of the load: parameters and seed of the first generated row, or hash, licence and citation.

    Raises TraceError if a recording is shorter than an episode.
    """
    from dcgrid_env.engine.exogenous.trace_pool import trace_pool

    return trace_pool(setting.scenario(5)).provenance[0].record()
