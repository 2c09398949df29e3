"""The command ``dcgrid list``."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import tyro
from rich.table import Table

from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.options import helps
from dcgrid_env.core.commands.terminal import plain_console

if TYPE_CHECKING:
    from dcgrid_env.agents import Card
    from dcgrid_env.core.plugins import Registry


Kind = Literal["scenarios", "fields", "feeders", "devices", "controllers", "traces"]
"""Kinds of things that the command lists."""


@dataclass(frozen=True)
class List(Command):
    """List scenarios, feeders, controllers, traces and fields.

    Without KINDS, the command lists everything.
    """

    kinds: tyro.conf.Positional[tuple[Kind, ...]] = ()
    """What to list: scenarios, fields (of scenarios), feeders, devices, controllers (with policies) or traces."""

    def run(self) -> None:
        """Print the tables."""
        console = plain_console()
        for kind in self.kinds or get_args(Kind):
            for title, rows in tables(kind).items():
                table = Table(title, "description", box=None, header_style="bold", pad_edge=False)
                for name, text in rows.items():
                    table.add_row(name, text)
                console.print(table, end="\n\n")


def tables(kind: str) -> dict[str, dict[str, str]]:
    """Return the tables of a kind: descriptions by name, by table title."""
    from dcgrid_env import FEEDER_REGISTRY, IDS, SCENARIO_REGISTRY
    from dcgrid_env.agents import Card
    from dcgrid_env.agents.controllers import ENTRIES as POLICIES
    from dcgrid_env.agents.policy.policy import FOLDER, SHIPPED
    from dcgrid_env.baselines import CONTROLLER_REGISTRY
    from dcgrid_env.devices import DEVICE_REGISTRY
    from dcgrid_env.grid.random_feeders.styles import STYLES
    from dcgrid_env.traces import TRACE_SOURCES
    from dcgrid_env.traces.recordings import RECORDINGS

    if kind == "scenarios":
        id_of = {scenario: f"{scenario}  ({name})" for name, scenario in IDS.items()}
        return {"scenario": {id_of.get(name, name): text for name, text in described(SCENARIO_REGISTRY).items()}}
    if kind == "fields":
        return {"scenario field": scenario_fields()}
    if kind == "feeders":
        styles = {name: style.about for name, style in STYLES.items()}
        return {"feeder": described(FEEDER_REGISTRY), "random feeder": styles}
    if kind == "devices":
        return {"device": described(DEVICE_REGISTRY)}
    if kind == "controllers":
        controllers = described(CONTROLLER_REGISTRY).items()
        return {
            "controller": {name: text for name, text in controllers if name not in POLICIES or name.endswith(":")},
            "policy": {name: card_line(Card.load(FOLDER / f"{name}.json")) for name in SHIPPED},
        }
    return {
        "trace": {name: source.description for name, source in TRACE_SOURCES.items()},
        "recording": {name: f"{r.description} ({r.licence})" for name, r in RECORDINGS.items()},
    }


def scenario_fields() -> dict[str, str]:
    """Return the description of each field of a scenario, its parts and its device groups, by path."""
    from dcgrid_env import Scenario
    from dcgrid_env.devices import device_kind
    from dcgrid_env.scenario.assembly import ALIASES, GROUPS, PARTS

    rows = {name: text for name, text in helps(Scenario).items() if name not in PARTS}
    for name, kind in (PARTS | {name: device_kind(kind) for name, kind in GROUPS.items()}).items():
        rows |= {f"{name}.{field.name}": helps(kind)[field.name] for field in dataclasses.fields(kind)}
    return rows | {name: f"short for {path}" for name, path in ALIASES.items()}


def described(registry: Registry) -> dict[str, str]:
    """Return the description of each name in a registry, with the package if a plug-in registered it."""
    origins = {name: registry.origin(name) for name in registry if not name.startswith(".")}
    return {name: registry[name][0] + (f" ({origin})" if origin else "") for name, origin in origins.items()}


def card_line(card: Card) -> str:
    """Return a policy's card on one line."""
    from dcgrid_env import METRICS
    from dcgrid_env.baselines.score import saved_pct

    line = f"{card.algorithm} trained on {card.scenario}, {card.n_parameters} parameters"
    if card.scored is None:
        return line
    delay_s = METRICS["delay_mean_s"].text(card.scored.delay_mean_s)
    scored, n = card.scored, len(card.scored.seeds)
    value, low, high = scored.score
    where = "" if scored.scenario == card.scenario else f" on {scored.scenario}"
    line += f"; score{where} {value:.3f} ({low:.3f} to {high:.3f}), delay {delay_s} s"
    if scored.droop_J is not None:
        line += f", {saved_pct(scored.J, scored.droop_J):.1f} % of J saved"
    if n < 2:
        return line
    if scored.over_seeds is not None:
        mean, least, most = scored.over_seeds
        return f"{line}; {n} seeds {mean:.3f} ({least:.3f} to {most:.3f} over seeds and episodes)"
    mean, least, most = sum(scored.seed_scores) / n, min(scored.seed_scores), max(scored.seed_scores)
    return f"{line}; {n} seeds {mean:.3f} ({least:.3f} to {most:.3f})"
