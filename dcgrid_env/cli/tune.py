"""The command ``dcgrid tune``."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from dcgrid_env.cli.command import GOES_ON
from dcgrid_env.cli.names import scenario_specs, split_names
from dcgrid_env.cli.progress import progress_bar
from dcgrid_env.cli.settings import Overrides, Scenarios, alone_in
from dcgrid_env.cli.terminal import plain_console
from dcgrid_env.cli.workers import OverWorkers
from dcgrid_env.core.files import write_json
from dcgrid_env.core.suggestions import unknown
from dcgrid_env.core.versions import meta

if TYPE_CHECKING:
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec
    from dcgrid_env.core.work.unit import Place

SPLIT = "validation"
Laws = dict[str, dict[str, dict[str, Any]]]
"""Law -> scenario, or scenarios with commas between -> parameters, J, trials and command."""


@dataclass(frozen=True)
class Tune(OverWorkers):
    """Tune control laws on the validation split of scenarios.

    Writes their parameters with the command that made each.

    The file is written after each law, so that an interrupted search goes on from there: what stands in it with the
    same command, for the same scenario, is not searched again (unless by --again), and what else stands in it stays.

    A droop's gains are chosen among those whose closed loop is stable: spectral radius at most 1, no limit cycle.

    `dcgrid run`, `benchmark`, `evaluate` and `train` find the parameters of other scenarios in results/tuned.json;
    with --tuned FILE the first three take them from another file.
    """

    laws: str = "all"
    """Laws separated by commas: droop, droop-q, deadband, peak-shaving, return-by-hand, staggered-return, smoothing,
    route-to-strongest, constant-q, placement; or all, of which those that a scenario has nothing for are left out."""
    scenarios: Scenarios = "all"
    """Scenarios separated by commas: names (dcgrid list), path/to/file.toml, path/to/file.py:function or
    package.module:function that makes your own; or all of those that ship."""
    set: Overrides = ()
    """Fields that are to be otherwise in every scenario, for instance --set horizon=60 sensing.noise_pu=0.005."""
    episodes: int = 20
    """Number of validation episodes of each scenario: seeds 0, 1, .."""
    together: bool = False
    """Whether the scenarios share one set of parameters, or each has its own."""
    out: Path = Path("results/tuned.json")
    """File to write."""
    again: bool = False
    """Whether to search again what stands in the file."""

    @property
    def resumes(self) -> str:
        """How to go on: what has been kept is not done again."""
        return "" if self.again else GOES_ON

    def run(self) -> None:
        """Tune what is due, print and write. Raise ValueError if a setting is invalid, before any search."""
        from dcgrid_env.baselines.tuning.tunable import TUNABLE

        specs = scenario_specs(self.scenarios, self.set, SPLIT)
        laws = list(TUNABLE) if self.laws.strip() == "all" else split_names(self.laws)
        there = f"choose among {', '.join(TUNABLE)}, or all"
        for law in laws:
            if law not in TUNABLE:
                raise ValueError(f"laws: {unknown('tunable law', law, TUNABLE, there)}")
        if not laws:
            raise ValueError(f"laws is {self.laws!r}; {there}")
        if self.episodes < 1:
            raise ValueError(f"episodes is {self.episodes}; give at least 1")
        place = self.place
        groups = [tuple(specs)] if self.together else [(name,) for name in specs]
        asked = [Search(law, group, tuple(specs[name] for name in group)) for group in groups for law in laws]
        if self.laws.strip() == "all":  # those that fit; a law that is named and does not is refused by itself
            asked = [search for search in asked if all(TUNABLE[search.law].fits(s.make(SPLIT)) for s in search.specs)]
        _kept(self.out)  # ValueError for another kind of file, before a folder is made
        with alone_in(self.out.parent, "dcgrid tune"):
            _search(self, asked, place)


class Search(NamedTuple):
    """A law and the scenarios that are to share its parameters, by their own names."""

    law: str
    names: tuple[str, ...]
    specs: tuple[ScenarioSpec, ...]

    @property
    def key(self) -> str:
        """Where it stands among the law's entries."""
        return ",".join(self.names)


def _search(cfg: Tune, asked: Sequence[Search], place: Place) -> None:
    """Search what is due, and write the file after each."""
    from dcgrid_env.baselines.carried import carried
    from dcgrid_env.core.work.unit import Unit

    kept = _kept(cfg.out)
    due = [search for search in asked if cfg.again or not _stands(kept, search, cfg.episodes)]
    console = plain_console()
    if len(due) < len(asked):
        done = len(asked) - len(due)
        console.print(f"{done} of {len(asked)} stand in {cfg.out} and are kept; --again searches them again")
    with progress_bar(console) as progress:
        bar = progress.add_task("laws tuned", total=len(asked), completed=len(asked) - len(due))
        units = [Unit(f"{search.law} of {search.key}", partial(_tuned, cfg.episodes), search) for search in due]
        shared = carried(place, [spec.where for search in due for spec in search.specs])
        for unit, entry in place.results(units, shared):
            search = unit.item
            kept.setdefault(search.law, {})[search.key] = entry
            _write(cfg.out, kept)
            values = ", ".join(f"{name} = {value}" for name, value in entry["parameters"].items())
            radius = entry.get("spectral_radius")
            said = f"; spectral radius {radius:.3f}" if radius is not None else ""
            console.print(f"{search.key} {search.law}: {values}; J {entry['J']:.4f}{said}")
            progress.advance(bar)
    console.print(f"wrote {cfg.out}" if due else f"nothing to search for {cfg.out}")


def _tuned(episodes: int, search: Search) -> dict[str, Any]:
    from dcgrid_env.baselines.tuning.search import tune

    best = tune(search.law, [spec.make(SPLIT) for spec in search.specs], episodes)
    return {
        "parameters": best.parameters,
        "J": best.score,
        "trials": best.trials,
        **({} if best.spectral_radius is None else {"spectral_radius": best.spectral_radius}),
        "command": _command(search, episodes),
        **_identity(search),
    }


def _identity(search: Search) -> dict[str, Any]:
    """What tells the scenarios of an entry from others of their names; nothing for presets as they are."""
    from dcgrid_env.baselines.tuning.tuned import identity

    if all(spec.is_preset for spec in search.specs):
        return {}
    identities = [identity(spec.make(SPLIT)) for spec in search.specs]
    return (
        identities[0] if len(identities) == 1 else {"scenario_hashes": [each["scenario_hash"] for each in identities]}
    )


def _command(search: Search, episodes: int) -> str:
    wheres = ",".join(spec.where for spec in search.specs)
    words = ["dcgrid", "tune", "--laws", search.law, "--scenarios", wheres]
    words += ["--set", *search.specs[0].set] if search.specs[0].set else []
    return shlex.join([*words, "--episodes", str(episodes), *(["--together"] if len(search.names) > 1 else [])])


def _stands(kept: Laws, search: Search, episodes: int) -> bool:
    """Whether an entry is of this very search."""
    entry = kept.get(search.law, {}).get(search.key, {})
    wanted = {"command": _command(search, episodes), **_identity(search)}
    return all(entry.get(name) == value for name, value in wanted.items())


def _kept(path: Path) -> Laws:
    """What stands in the file; ValueError if it cannot be one of tuned parameters."""
    from dcgrid_env.baselines.tuning.tuned import read_tuned

    if path.is_dir():
        raise ValueError(f"out is {path}, a folder; give a file")
    return read_tuned(path)


def _write(path: Path, laws: Laws) -> None:
    """Laws in the order of ``TUNABLE``, scenarios in that of the presets; others behind them."""
    from dcgrid_env import PRESETS
    from dcgrid_env.baselines.tuning.tunable import TUNABLE

    ordered = {law: {key: laws[law][key] for key in _first(PRESETS, laws[law])} for law in _first(TUNABLE, laws)}
    write_json(path, {"versions": meta()["versions"], "laws": ordered})


def _first(leading: Iterable[str], names: Iterable[str]) -> list[str]:
    """Names, those of ``leading`` first and in its order."""
    order = {name: place for place, name in enumerate(leading)}
    return sorted(names, key=lambda name: order.get(name, len(order)))
