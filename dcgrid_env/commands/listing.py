"""Show the scenarios, feeders, controllers and traces that can be named."""

from __future__ import annotations

from dataclasses import dataclass

from rich.console import Console
from rich.table import Table


@dataclass(frozen=True)
class List:
    """Nothing to set."""


def main(cfg: List) -> None:
    """Print the tables."""
    from dcgrid_env import FEEDERS, IDS, PRESETS
    from dcgrid_env.baselines import CONTROLLERS, TUNED
    from dcgrid_env.traces import TRACE_SOURCES
    from dcgrid_env.traces.recordings import RECORDINGS

    id_of = {scenario: name for name, scenario in IDS.items()}
    tables = {
        "scenario": {f"{name}  ({id_of[name]})": text for name, text in PRESETS.items()},
        "feeder": FEEDERS,
        "controller": {name: text for name, (text, _) in CONTROLLERS.items()} | TUNED,
        "trace": {name: source.description for name, source in TRACE_SOURCES.items()},
        "recording": {name: f"{r.description} ({r.licence})" for name, r in RECORDINGS.items()},
    }
    console = Console()
    for kind, rows in tables.items():
        table = Table(kind, "what it is", box=None, header_style="bold", pad_edge=False)
        for name, text in rows.items():
            table.add_row(name, text)
        console.print(table, end="\n\n")
