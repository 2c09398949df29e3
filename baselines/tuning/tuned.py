"""Find parameters tuned on the validation split: the bundled ones of each preset, and those of ``dcgrid tune``.

The parameters of the presets are in ``data/tuned.json`` with the command that made them. They apply to every scenario
with the preset's name and grid, since a law's gains depend on feeder, devices and step. Load, noise, horizon and cost
may differ, as in studies of robustness, and so may agents of equipment and the timers and set points of regulators.
After a change of the grid, tune the law again.
"""

from __future__ import annotations

import dataclasses
import json
from functools import cache
from importlib.resources import files
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

from dcgrid_env import (
    PRESETS,
    Background,
    Cost,
    GridRequest,
    RegulatorControl,
    Scenario,
    Sensing,
    Workload,
    make_scenario,
    scenario_hash,
    under_own_control,
)
from dcgrid_env.baselines.controller import Controller
from dcgrid_env.baselines.scenario_spec import options_of
from dcgrid_env.baselines.tuning.tunable import TUNABLE
from dcgrid_env.core.user_files import is_file, read_json
from dcgrid_env.core.work.unit import shared

CARRIED = "tuned parameters"
"""Name of the shared value with the contents of files of ``dcgrid tune``, by their paths, on workers elsewhere."""
SUFFIX = "-tuned"
USER_FILE = Path("results/tuned.json")
"""Where ``dcgrid tune`` writes by default, in the working directory."""
_OF_SITES = ("idle_share", "f_min_mhz", "f_max_mhz", "s_rated_share", "q_max_share", "boost_share")
NUMBERS = ("source_voltage_pu", *(f"datacenters.{name}" for name in _OF_SITES), "dt_s")
GRID = (
    "feeder", "background.capacitors", "datacenters.count", "datacenters.buses", "datacenters.p_rated_kw",
    "datacenters.clock_law", "inverters.buses", "inverters.s_rated_kva", *NUMBERS,
)  # fmt: skip
"""Paths of the fields of a scenario that a law's gains depend on."""


class TunedParameters(NamedTuple):
    """Tuned parameters and the file that contains them."""

    parameters: dict[str, Any]
    file: Path | None
    """File of the parameters; None for the bundled ones."""


def tuned_parameters(law: str, scenario: Scenario, path: str | Path | None = None) -> TunedParameters:
    """Find the keyword arguments of a law for a scenario.

    Parameters
    ----------
    law
        One of ``TUNABLE``.
    scenario
        Scenario to drive.
    path
        A file of ``dcgrid tune`` that must contain the parameters. If None, the first of these is used: the parameters
        in ``results/tuned.json`` in the working directory for exactly this scenario, the bundled ones, and those in
        that file for this name and grid.

    Raises
    ------
    ValueError
        If parameters for this scenario are missing; the message names the difference and the command that finds them.
    """
    file = USER_FILE if path is None else Path(path)
    require_tuned(path)
    entry = read_tuned(file).get(law, {}).get(scenario.name)
    shipped = None if path else _shipped().get(law, {}).get(scenario.name)
    fits = entry is not None and _grid_hash_of(entry, scenario.name) == grid_hash(scenario)
    if entry is not None and fits and (path is not None or shipped is None or _is_of(entry, scenario)):
        return TunedParameters(_arguments(entry), file)
    differs = _difference_from_preset(scenario) if shipped else None
    if shipped and differs is None:
        return TunedParameters(_arguments(shipped), None)
    if entry is not None and fits:
        return TunedParameters(_arguments(entry), file)
    raise ValueError(_missing_message(law, scenario, path, entry is not None, differs))


def tuned_controller(law: str, scenario: Scenario, path: str | Path | None = None) -> Controller:
    """Make a law with the parameters tuned for a scenario, see :func:`tuned_parameters`; untuned if it does not fit."""
    if not TUNABLE[law].fits(scenario):
        return TUNABLE[law].law()  # its reset raises the error
    return TUNABLE[law].law(**tuned_parameters(law, scenario, path).parameters)


def require_tuned(path: str | Path | None) -> None:
    """Raise ValueError if the path is given and is not a file of ``dcgrid tune``."""
    if path is None:
        return
    if str(path) not in shared(CARRIED, {}) and not is_file(Path(path), ValueError):
        raise ValueError(f"tuned is {str(path)!r}, which is no file; give one that dcgrid tune wrote")
    read_tuned(Path(path))


def read_tuned(path: Path) -> dict[str, dict[str, dict[str, Any]]]:
    """Read the entries of a file of ``dcgrid tune``, by law and scenario; empty if the file does not exist.

    Raises ValueError if the file does not contain tuned parameters.
    """
    carried = shared(CARRIED, {}).get(str(path))
    if carried is not None or not path.exists():
        return carried or {}
    content = read_json(path, ValueError, "pass a file that dcgrid tune wrote")
    try:
        laws = content["laws"]
        if all(isinstance(entry["parameters"], dict) for of_law in laws.values() for entry in of_law.values()):
            return laws
    except (KeyError, TypeError, AttributeError):
        pass
    raise ValueError(f"{path}: is not a file of tuned parameters; pass a file that dcgrid tune wrote")


def own_parameters(path: Path | None) -> dict[str, dict[str, dict[str, dict[str, Any]]]]:
    """Return the content of a file of ``dcgrid tune`` by its path; by default that in the working directory."""
    file = USER_FILE if path is None else path
    return {str(file): read_tuned(file)} if file.is_file() else {}


def identity(scenario: Scenario) -> dict[str, str]:
    """Return the hashes that identify an entry's scenario: that of all fields, and that of the grid."""
    return {
        "scenario_hash": scenario_hash(scenario.replace(split="validation")),
        "grid_hash": grid_hash(scenario),
    }


def grid_hash(scenario: Scenario) -> str:
    """Return the hash of the fields that a law's gains depend on."""
    return scenario_hash(_grid(_without_agents(scenario)))


def grid_difference(scenario: Scenario, other: Scenario) -> str | None:
    """Return the name of the first differing field that gains depend on; None if all are equal."""
    return _grid(_without_agents(scenario)).difference(_grid(_without_agents(other)))


def _without_agents(scenario: Scenario) -> Scenario:
    """Return the scenario as the law drives it, with the default timers and set points of regulators."""
    scenario, default = under_own_control(scenario), RegulatorControl()
    if scenario.grid_control.regulator_settings == default:
        return scenario
    return scenario.replace(grid_control={"regulator_settings": default})


def _grid(scenario: Scenario) -> Scenario:
    """Reduce a scenario to its grid: other fields get their defaults, numbers are floats, ratings are per device."""
    defaults = {f.name: f.default for f in dataclasses.fields(scenario) if f.default is not dataclasses.MISSING}
    parts: dict[str, Any] = {"workload": Workload(), "sensing": Sensing(), "cost": Cost()}
    parts["grid_request"] = GridRequest()
    parts["background"] = Background(capacitors=scenario.background.capacitors)
    if scenario.power_flow == "sweep":
        parts["power_flow"] = "sweep"
    numbers = {name: float(attrgetter(name)(scenario)) for name in NUMBERS}
    p_rated_kw, s_kva = (
        tuple(rated.tolist())
        for rated in (scenario.datacenters.parameters.p_rated_kw, scenario.inverters.parameters.s_rated_kva)
    )
    ratings = {"datacenters.p_rated_kw": p_rated_kw, "inverters.s_rated_kva": s_kva, "inverters.injection": None}
    return scenario.replace(name="grid", **(defaults | parts | ratings | numbers))


@cache
def _shipped() -> dict[str, Any]:
    text = (files("dcgrid_env.baselines.data") / "tuned.json").read_text(encoding="utf-8")
    return json.loads(text)["laws"]


def _difference_from_preset(scenario: Scenario) -> str | None:
    return grid_difference(scenario, make_scenario(scenario.name))


def _grid_hash_of(entry: dict[str, Any], name: str) -> str | None:
    """Return the grid hash of an entry; an entry without hashes belongs to the preset of its name."""
    return entry.get("grid_hash") or (grid_hash(make_scenario(name)) if name in PRESETS else None)


def _is_of(entry: dict[str, Any], scenario: Scenario) -> bool:
    return entry.get("scenario_hash") == identity(scenario)["scenario_hash"]


def _arguments(entry: dict[str, Any]) -> dict[str, Any]:
    return {name: tuple(value) if isinstance(value, list) else value for name, value in entry["parameters"].items()}


def _presets_of(law: str, scenario: Scenario) -> list[str]:
    """Return the presets with the grid of a scenario that have bundled parameters of a law."""
    names = [name for name in _shipped().get(law, {}) if name in PRESETS]
    return [name for name in names if grid_difference(scenario, make_scenario(name)) is None]


def _missing_message(law: str, scenario: Scenario, path: str | Path | None, another: bool, differs: str | None) -> str:
    """Explain why tuned parameters are missing, and name the command that finds them."""
    said = f"no tuned parameters of {law!r} for scenario {scenario.name!r}"
    if differs:
        said += f": those that ship are of the preset of that name, from which this one differs in {differs}"
    elif path is None:
        said += f" ship with the package, nor stand in {USER_FILE}"
        if same := _presets_of(law, scenario):
            said += f"; its grid is that of {' and '.join(same)}, whose it takes with --set name={same[0]}"
    else:
        said += f" stand in {path}"
    if another:
        said += f"; {path or USER_FILE} has some of another {scenario.name!r}, whose feeder, devices or step differ"
    out = f" --out {path}" if path else ""
    return f"{said}; find its own with `dcgrid tune --laws {law} {options_of(scenario, '--scenarios')}{out}`"
