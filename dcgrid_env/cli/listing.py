"""Show the scenarios, feeders, controllers and traces that can be named."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.table import Table

from dcgrid_env.cli.terminal import plain_console

if TYPE_CHECKING:
    from dcgrid_env.agents import Card


@dataclass(frozen=True)
class List:
    """Nothing to set."""


def main(cfg: List) -> None:
    """Print the tables."""
    from dcgrid_env import FEEDERS, IDS, PRESETS
    from dcgrid_env.agents import Card
    from dcgrid_env.agents.policy.policy import FOLDER, SHIPPED
    from dcgrid_env.baselines import CONTROLLERS, TUNED
    from dcgrid_env.traces import TRACE_SOURCES
    from dcgrid_env.traces.recordings import RECORDINGS

    id_of = {scenario: name for name, scenario in IDS.items()}
    tables = {
        "scenario": {f"{name}  ({id_of[name]})": text for name, text in PRESETS.items()},
        "feeder": FEEDERS,
        "controller": {name: text for name, (text, _) in CONTROLLERS.items()} | TUNED,
        "policy": {name: card_line(Card.load(FOLDER / f"{name}.json")) for name in SHIPPED},
        "trace": {name: source.description for name, source in TRACE_SOURCES.items()},
        "recording": {name: f"{r.description} ({r.licence})" for name, r in RECORDINGS.items()},
    }
    console = plain_console()
    for kind, rows in tables.items():
        table = Table(kind, "what it is", box=None, header_style="bold", pad_edge=False)
        for name, text in rows.items():
            table.add_row(name, text)
        console.print(table, end="\n\n")


def card_line(card: Card) -> str:
    """A policy's card on one line."""
    line = f"{card.algorithm} trained on {card.scenario}, {card.n_parameters} figures"
    if card.scored is None:
        return line
    found, n = card.scored, len(card.scored.seeds)
    value, low, high = found.score
    where = "" if found.scenario == card.scenario else f" on {found.scenario}"
    line += f"; score{where} {value:.3f} ({low:.3f} to {high:.3f}), delay {found.delay_mean_s:.2f} s"
    if n < 2:
        return line
    mean, least, most = sum(found.seed_scores) / n, min(found.seed_scores), max(found.seed_scores)
    return f"{line}; {n} seeds {mean:.3f} ({least:.3f} to {most:.3f})"
