"""Tune laws on the validation split of scenarios; writes their parameters with the command that made each.

The file is written after each law, so that an interrupted search goes on from there: what stands in it with the same
command is not searched again (unless by --again), and what else stands in it stays.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from dcgrid_env.commands.named import scenario_names, split_names
from dcgrid_env.commands.progress import progress_bar
from dcgrid_env.commands.results import meta, write_json
from dcgrid_env.commands.settings import check_folder, processes

Laws = dict[str, dict[str, dict[str, Any]]]
"""Law -> scenario, or scenarios with commas between -> parameters, J, trials and command."""


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
    again: bool = False
    """Search again what stands in the file."""


def main(cfg: Tune) -> None:
    """Tune what is due, print and write. ValueError for a setting that cannot be, before anything is searched."""
    from rich.console import Console

    from dcgrid_env.baselines.tune import TUNABLE
    from dcgrid_env.benchmark.pool import Died, each

    names = scenario_names(cfg.scenarios)
    laws = list(TUNABLE) if cfg.laws.strip() == "all" else split_names(cfg.laws)
    unknown = [law for law in laws if law not in TUNABLE]
    if unknown or not laws:
        raise ValueError(f"laws is {cfg.laws!r}; choose among {', '.join(TUNABLE)}, or all")
    if cfg.episodes < 1:
        raise ValueError(f"episodes is {cfg.episodes}; give at least 1")
    jobs, kept = processes(cfg.jobs), _kept(cfg.out)
    check_folder(cfg.out.parent)
    groups = [tuple(names)] if cfg.together else [(name,) for name in names]
    asked = [(law, group) for group in groups for law in laws]
    due = [task for task in asked if cfg.again or not _stands(kept, task, cfg.episodes)]
    console = Console()
    if len(due) < len(asked):
        done = len(asked) - len(due)
        console.print(f"{done} of {len(asked)} stand in {cfg.out} and are kept; --again searches them again")
    with progress_bar(console) as progress:
        bar = progress.add_task("laws tuned", total=len(asked), completed=len(asked) - len(due))
        for (law, group), found in each(partial(_tuned, cfg.episodes), due, jobs):
            if isinstance(found, Died):
                raise OSError(f"the process that tuned {law} for {','.join(group)} ended with code {found.exit_code}")
            kept.setdefault(law, {})[",".join(group)] = found
            _write(cfg.out, kept)
            values = ", ".join(f"{name} = {value}" for name, value in found["parameters"].items())
            console.print(f"{','.join(group)} {law}: {values}; J {found['J']:.4f}", highlight=False)
            progress.advance(bar)
    console.print(f"wrote {cfg.out}" if due else f"nothing to search for {cfg.out}", highlight=False)


def _tuned(episodes: int, task: tuple[str, tuple[str, ...]]) -> dict[str, Any]:
    from dcgrid_env import make_scenario
    from dcgrid_env.baselines.tune import tune

    law, names = task
    found = tune(law, [make_scenario(name, split="validation") for name in names], episodes)
    return {
        "parameters": found.parameters,
        "J": found.score,
        "trials": found.trials,
        "command": _command(task, episodes),
    }


def _command(task: tuple[str, tuple[str, ...]], episodes: int) -> str:
    law, names = task
    command = f"dcgrid tune --laws {law} --scenarios {','.join(names)} --episodes {episodes}"
    return command + " --together" * (len(names) > 1)


def _stands(kept: Laws, task: tuple[str, tuple[str, ...]], episodes: int) -> bool:
    law, names = task
    return kept.get(law, {}).get(",".join(names), {}).get("command") == _command(task, episodes)


def _kept(path: Path) -> Laws:
    """What stands in the file; ValueError if it cannot be one of tuned parameters."""
    if path.is_dir():
        raise ValueError(f"out is {path}, a folder; give a file")
    if not path.exists():
        return {}
    try:
        laws = json.loads(path.read_text(encoding="utf-8"))["laws"]
        if all(isinstance(entry["parameters"], dict) for of_law in laws.values() for entry in of_law.values()):
            return laws
    except (ValueError, KeyError, TypeError, AttributeError):
        pass
    raise ValueError(f"{path} is no file of tuned parameters; give another --out")


def _write(path: Path, laws: Laws) -> None:
    """Laws in the order of ``TUNABLE``, scenarios in that of the presets; others behind them."""
    from dcgrid_env import PRESETS
    from dcgrid_env.baselines.tune import TUNABLE

    ordered = {law: {key: laws[law][key] for key in _first(PRESETS, laws[law])} for law in _first(TUNABLE, laws)}
    write_json(path, {"versions": meta()["versions"], "laws": ordered})


def _first(known: Iterable[str], names: Iterable[str]) -> list[str]:
    """Names, those that are known first and in the order in which they are known."""
    order = {name: place for place, name in enumerate(known)}
    return sorted(names, key=lambda name: order.get(name, len(order)))
