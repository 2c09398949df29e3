"""Tune laws on the validation split of scenarios; writes their parameters with the command that made them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from dcgrid_env.commands.named import scenario_names, split_names
from dcgrid_env.commands.results import meta, write_json


@dataclass(frozen=True)
class Tune:
    """What to tune."""

    laws: str = "all"
    """Laws separated by commas: droop, droop-q, deadband, constant-q, placement; or all."""
    scenarios: str = "all"
    """Names of scenarios separated by commas (dcgrid list), or all."""
    episodes: int = 20
    """Validation episodes of each scenario: seeds 0, 1, .."""
    together: bool = False
    """Whether the scenarios share one set of parameters, or each has its own."""
    jobs: int | None = None
    """Processes; all cores by default."""
    out: Path = Path("results/tuned.json")
    """File to write."""


def main(cfg: Tune) -> None:
    """Tune, print and write. ValueError for a setting that cannot be, before anything is written."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from dcgrid_env.baselines.tune import TUNABLE
    from dcgrid_env.benchmark.pool import Died, each
    from dcgrid_env.powerflow.threads import n_threads

    names = scenario_names(cfg.scenarios)
    laws = list(TUNABLE) if cfg.laws.strip() == "all" else split_names(cfg.laws)
    unknown = [law for law in laws if law not in TUNABLE]
    if unknown or not laws:
        raise ValueError(f"laws is {cfg.laws!r}; choose among {', '.join(TUNABLE)}, or all")
    if cfg.episodes < 1:
        raise ValueError(f"episodes is {cfg.episodes}; give at least 1")
    groups = [tuple(names)] if cfg.together else [(name,) for name in names]
    due = [(law, group) for group in groups for law in laws]
    console = Console()
    columns = (TextColumn("{task.description:>16}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    found: dict[str, dict[str, Any]] = {law: {} for law in laws}
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("laws tuned", total=len(due))
        for (law, group), result in each(partial(_tuned, cfg.episodes), due, cfg.jobs or n_threads()):
            if isinstance(result, Died):
                raise OSError(f"the process that tuned {law} ended with code {result.exit_code}")
            found[law][",".join(group)] = result
            values = ", ".join(f"{name} = {value}" for name, value in result["parameters"].items())
            console.print(f"{','.join(group)} {law}: {values}; J {result['J']:.4f}", highlight=False)
            progress.advance(task)
    ordered = {law: {",".join(group): found[law][",".join(group)] for group in groups} for law in laws}
    write_json(cfg.out, {"meta": meta() | {"episodes": cfg.episodes}, "laws": ordered})
    console.print(f"wrote {cfg.out}")


def _tuned(episodes: int, task: tuple[str, tuple[str, ...]]) -> dict[str, Any]:
    from dcgrid_env import make_scenario
    from dcgrid_env.baselines.tune import tune

    law, names = task
    found = tune(law, [make_scenario(name, split="validation") for name in names], episodes)
    return {"parameters": found.parameters, "J": found.score, "trials": found.trials}
