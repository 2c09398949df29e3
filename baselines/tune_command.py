"""The command ``dcgrid tune``."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from dcgrid_env.baselines.scenario_names import scenario_specs
from dcgrid_env.core.commands.command import GOES_ON
from dcgrid_env.core.commands.names import split_names
from dcgrid_env.core.commands.progress import progress_bar
from dcgrid_env.core.commands.settings import Overrides, Scenarios, alone_in
from dcgrid_env.core.commands.terminal import plain_console
from dcgrid_env.core.commands.workers import OverWorkers
from dcgrid_env.core.files import write_json
from dcgrid_env.core.suggestions import unknown
from dcgrid_env.core.versions import meta

if TYPE_CHECKING:
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec
    from dcgrid_env.core.work.unit import Place

SPLIT = "validation"
Laws = dict[str, dict[str, dict[str, Any]]]
"""Parameters, J, trials and command by law and by scenario (or scenarios separated by commas)."""


@dataclass(frozen=True)
class Tune(OverWorkers):
    """Tune control laws on the validation split of scenarios.

    Writes the best parameters of each law, with the command that found them.

    The file is written after each law. If you run an interrupted command again, it keeps the laws that are done for the
    same scenario and settings, unless you pass --again. Other entries of the file stay unchanged.

    The laws set-points, static and two-timescale choose constant set points of regulators and capacitor banks. Offsets
    of controlled regulators are fields of the scenario: the command prints them as an option --set.

    Droop gains are chosen among those with a stable closed loop: spectral radius at most 1, no limit cycle.

    `dcgrid run`, `benchmark`, `evaluate` and `train` use results/tuned.json if it has gains for their scenario. The
    first three take another file with --tuned FILE.
    """

    laws: str = "all"
    """Laws, separated by commas: droop, droop-q, deadband, peak-shaving, return-by-hand, staggered-return, smoothing,
    route-to-strongest, constant-q, placement, set-points, static or two-timescale; or all for every law that applies to
    the scenario."""
    scenarios: Scenarios = "all"
    """Scenarios, separated by commas: names (dcgrid list), path/to/file.toml, path/to/file.py:function or
    package.module:function; or all for every preset."""
    set: Overrides = ()
    """Fields to override in every scenario, for example --set horizon=60 sensing.noise_pu=0.005."""
    episodes: int = 20
    """Number of validation episodes for each scenario, with seeds 0, 1, ..."""
    together: bool = False
    """Tune one set of parameters for all scenarios together instead of one set for each."""
    out: Path = Path("results/tuned.json")
    """Output file."""
    again: bool = False
    """Repeat searches whose results are already in the file."""

    @property
    def resumes(self) -> str:
        """Message on how to resume; finished work is kept."""
        return "" if self.again else GOES_ON

    def run(self) -> None:
        """Tune the remaining laws, print and write; raise ValueError before any search if a setting is invalid."""
        from dcgrid_env.baselines.tuning.tunable import TUNABLE

        specs = scenario_specs(self.scenarios, self.set, SPLIT)
        laws = list(TUNABLE) if self.laws.strip() == "all" else split_names(self.laws)
        there = f"choose from {', '.join(TUNABLE)}, or all"
        for law in laws:
            if law not in TUNABLE:
                raise ValueError(f"laws: {unknown('tunable law', law, TUNABLE, there)}")
        if not laws:
            raise ValueError(f"laws: must name at least one law, got {self.laws!r}; {there}")
        place = self.place
        groups = [tuple(specs)] if self.together else [(name,) for name in specs]
        searches = [Search(law, group, tuple(specs[name] for name in group)) for group in groups for law in laws]
        if self.laws.strip() == "all":  # laws that apply; a named law that does not apply raises an error
            searches = [
                search for search in searches if all(TUNABLE[search.law].fits(s.make(SPLIT)) for s in search.specs)
            ]
        _kept(self.out)  # raise ValueError for another kind of file before a folder is created
        with alone_in(self.out.parent, "dcgrid tune"):
            _search(self, searches, place)


class Search(NamedTuple):
    """A law, and the scenarios that share its parameters."""

    law: str
    names: tuple[str, ...]
    specs: tuple[ScenarioSpec, ...]

    @property
    def key(self) -> str:
        """Key among the entries of the law."""
        return ",".join(self.names)


def _search(cfg: Tune, searches: Sequence[Search], place: Place) -> None:
    """Run the remaining searches, and write the file after each."""
    from dcgrid_env.baselines.carried import carried
    from dcgrid_env.core.work.unit import Unit

    kept = _kept(cfg.out)
    due = [search for search in searches if cfg.again or not _is_tuned(kept, search, cfg.episodes)]
    console = plain_console()
    if len(due) < len(searches):
        done = len(searches) - len(due)
        console.print(
            f"kept {done} of {len(searches)} results that are already in {cfg.out}; --again repeats the searches"
        )
    with progress_bar(console) as progress:
        bar = progress.add_task("laws tuned", total=len(searches), completed=len(searches) - len(due))
        units = [Unit(f"{search.law} of {search.key}", partial(_tuned, cfg.episodes), search) for search in due]
        shared = carried(place, [spec.where for search in due for spec in search.specs])
        for unit, entry in place.results(units, shared):
            search = unit.item
            kept.setdefault(search.law, {})[search.key] = entry
            _write(cfg.out, kept)
            values = ", ".join(f"{name} = {value}" for name, value in entry["parameters"].items())
            radius = entry.get("spectral_radius")
            said = f"; spectral radius {radius:.3f}" if radius is not None else ""
            if required := entry.get("set"):
                said += f"; set in the scenario: --set {shlex.join(required)}"
            console.print(f"{search.key} {search.law}: {values}; J {entry['J']:.4f}{said}")
            progress.advance(bar)
    console.print(f"wrote {cfg.out}" if due else f"nothing to do: all results are already in {cfg.out}")


def _tuned(episodes: int, search: Search) -> dict[str, Any]:
    from dcgrid_env.baselines.tuning.search import tune

    best = tune(search.law, [spec.make(SPLIT) for spec in search.specs], episodes)
    return {
        "parameters": best.parameters,
        "J": best.score,
        "trials": best.trials,
        **({} if best.spectral_radius is None else {"spectral_radius": best.spectral_radius}),
        **(
            {"set": [f"{field}={json.dumps(value)}" for field, value in best.overrides.items()]}
            if best.overrides
            else {}
        ),
        "command": _command(search, episodes),
        **_identity(search),
    }


def _identity(search: Search) -> dict[str, Any]:
    """Return the hashes of an entry's scenarios; empty for unchanged presets."""
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


def _is_tuned(kept: Laws, search: Search, episodes: int) -> bool:
    """Return whether the file has the result of this exact search."""
    entry = kept.get(search.law, {}).get(search.key, {})
    wanted = {"command": _command(search, episodes), **_identity(search)}
    return all(entry.get(name) == value for name, value in wanted.items())


def _kept(path: Path) -> Laws:
    """Return the contents of the file; raise ValueError if it is not a file of tuned parameters."""
    from dcgrid_env.baselines.tuning.tuned import read_tuned

    if path.is_dir():
        raise ValueError(f"out: must be a file, got the folder {path}")
    return read_tuned(path)


def _write(path: Path, laws: Laws) -> None:
    """Write laws in the order of ``TUNABLE``, scenarios in the order of the presets; others follow."""
    from dcgrid_env import PRESETS
    from dcgrid_env.baselines.tuning.tunable import TUNABLE

    ordered = {law: {key: laws[law][key] for key in _first(PRESETS, laws[law])} for law in _first(TUNABLE, laws)}
    write_json(path, {"versions": meta()["versions"], "laws": ordered})


def _first(leading: Iterable[str], names: Iterable[str]) -> list[str]:
    """Return names, with those of ``leading`` first and in its order."""
    order = {name: place for place, name in enumerate(leading)}
    return sorted(names, key=lambda name: order.get(name, len(order)))
