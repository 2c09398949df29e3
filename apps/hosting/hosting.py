"""Compute the hosting capacity of all candidate buses under several controllers, in units of work for a place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.apps.hosting.added_site import AddedSite
from dcgrid_env.apps.hosting.bus_search import worst_samples
from dcgrid_env.apps.hosting.capacity_study import Study
from dcgrid_env.apps.hosting.load_hours import Windows, with_worst_hours
from dcgrid_env.apps.hosting.site_search import BusCapacity, search_buses
from dcgrid_env.apps.hosting.trial import overloaded_nodes, trials
from dcgrid_env.apps.hosting.worst_hours import SNAPSHOT, exempt, reasons, snapshots
from dcgrid_env.baselines.carried import carried
from dcgrid_env.baselines.controller import Controller
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.baselines.registry import TUNED, find_controller
from dcgrid_env.baselines.tuning.tunable import TUNABLE
from dcgrid_env.baselines.tuning.tuned import SUFFIX
from dcgrid_env.core.work.local_pool import ONE_PROCESS
from dcgrid_env.core.work.unit import Place, Unit, shared


def study_controller(spec: str, scenario: Scenario, tuned: Path | None) -> tuple[Controller, str]:
    """Make a new controller for a study's scenario, and a note on it, which may be empty.

    A tuned law uses the gains found for the scenario without the added site. If none are known, it uses the defaults of
    the law, and the note reports this. A controller with a model has a model of the feeder with the added site. A
    policy receives the observations of the site's agent, whatever it was trained on.

    Raises
    ------
    ValueError
        If ``spec`` does not name a controller, or the file ``tuned`` does not contain the gains of a tuned law.
    """
    if spec not in TUNED or tuned is not None:
        return find_controller(spec, scenario, tuned), ""
    try:
        return find_controller(spec, scenario), ""
    except ValueError:
        law = spec.removesuffix(SUFFIX)
        return TUNABLE[law].law(), (
            f"{spec}: no gains are known for this feeder and these devices, so it has the defaults of {law} (dcgrid "
            "tune finds them on a scenario, --scenario and --tuned take them)"
        )


UNCONTROLLED = "none"
"""Name of the controller that does nothing."""
_SLOW = ("mpc",)
"""Prefixes of the names of controllers whose tasks are started first."""
_PARTS = 2
"""Units of each controller and worker: a unit of few buses wastes batches, few units leave workers idle."""
_STUDY, _WINDOWS, _EXEMPT = "study", "windows", "exempt"
"""Names of the shared values: the study, its windows, and the nodes whose branch is overloaded without any site."""


@dataclass(frozen=True)
class Capacities:
    """Results of a study."""

    study: Study
    buses: tuple[str, ...]
    """Candidate buses, in the order of the feeder."""
    controllers: tuple[str, ...]
    by_controller: dict[str, tuple[BusCapacity, ...]]
    """Capacities by controller, in the order of the buses."""
    snapshot: tuple[BusCapacity, ...]
    """Capacities in one power flow of every hour, with the site at its rating and without control."""
    windows: Windows
    """Windows that were simulated."""
    overloaded: tuple[str, ...]
    """Branches that are overloaded without any site; the capacity behind them is zero, and they do not count
    elsewhere."""
    notes: tuple[str, ...]
    """Notes on the controllers."""


class _BusRequest(NamedTuple):
    """A bus, and the size and the windows to try first there."""

    bus: int
    guess: int
    critical: tuple[int, ...]
    snapshot: BusCapacity


@dataclass(frozen=True)
class _Task:
    controller: str
    tuned: Path | None
    requests: tuple[_BusRequest, ...]


def hosting_capacity(
    study: Study,
    controllers: Sequence[str],
    place: Place = ONE_PROCESS,
    tuned: Path | None = None,
    on_buses: Callable[[str, int], None] | None = None,
) -> Capacities:
    """Find the largest data centre that each candidate bus can host under each controller.

    One data centre is added at one bus at a time. A size is feasible if all bus voltages and all branches of known
    rating stay within their limits in all windows after the settling time. The allowed share of seconds is exempt.
    Without control, a size must also be feasible in one power flow of every hour. Sizes are multiples of a step;
    ``bus_search`` describes the search.

    Parameters
    ----------
    study
        Buses, limits and sampled load.
    controllers
        Controllers as named on the command line: ``none``, ``droop-tuned``, ``mpc``, a policy's name or file, or a
        user's class.
    place
        Where the work runs; its workers share controllers and buses. The results do not depend on it.
    tuned
        A file of ``dcgrid tune`` that must contain the gains of tuned laws.
    on_buses
        Function called with a controller and the number of buses that are finished under it, for progress.

    Returns
    -------
    Capacities
        For each controller and bus, the capacity in MW and the limit that the next size breaks. Also the mean and 95th
        percentile of the delay of the site's work in s, and its unserved share in %.

    Raises
    ------
    ValueError
        If the study is invalid, or a controller is unknown or cannot drive such a scenario; the message names it.
    LostUnits
        If buses have no result under a controller.
    """
    names = tuple(dict.fromkeys(controllers))
    if not names:
        raise ValueError("controllers is empty; name at least one")
    notes = tuple(note for name in names if (note := study_controller(name, study.scenario, tuned)[1]))
    buses = study.candidates()
    values = {_STUDY: study, _EXEMPT: exempt(study)}
    parts = _shared_out(len(buses), _PARTS * place.workers if place.workers > 1 else 1)
    bus_ids = study.scenario.feeder.bus_ids
    shots = [Unit(f"snapshots at buses {_span(bus_ids, buses[part])}", _snapshots, buses[part]) for part in parts]
    shot = {unit.key: result for unit, result in place.results(shots, values, how_to_go_on="")}
    snapshot, worst = zip(*(result for unit in shots for result in shot[unit.key]), strict=True)
    windows = with_worst_hours(study, reasons([str(bus_ids[bus]) for bus in buses], worst))
    guesses = [max(1, round(capacity.capacity_mw / study.step_mw)) for capacity in snapshot]
    site = AddedSite(study, windows)
    site.exempt = overloaded_nodes(site)
    critical = critical_samples(site, buses, guesses)
    tasks = [
        _Task(name, tuned, tuple(_BusRequest(int(buses[i]), guesses[i], critical[i], snapshot[i]) for i in part))
        for name in sorted(names, key=lambda name: not name.startswith(_SLOW))
        for part in parts
    ]
    capacities: dict[tuple[str, str], BusCapacity] = {}
    units = [
        Unit(f"{task.controller} at buses {_span(bus_ids, [request.bus for request in task.requests])}", _work, task)
        for task in tasks
    ]
    values = {_STUDY: study, _WINDOWS: windows, _EXEMPT: site.exempt} | carried(place, (), names, tuned)
    for unit, result in place.results(units, values, how_to_go_on=""):
        task = unit.item
        capacities |= {(task.controller, capacity.bus): capacity for capacity in result}
        if on_buses is not None:
            on_buses(task.controller, len(result))
    ids = tuple(bus_ids[bus] for bus in buses)
    by_controller = {name: tuple(capacities[name, bus] for bus in ids) for name in names}
    feeder = study.scenario.feeder
    overloaded_buses = np.unique(np.asarray(feeder.node_bus)[site.exempt[: feeder.n_node]])
    overloaded = tuple(feeder.branch_names[bus - 1] for bus in overloaded_buses)
    return Capacities(study, ids, names, by_controller, tuple(snapshot), windows, overloaded, notes)


def critical_samples(site: AddedSite, buses: np.ndarray, sizes: Sequence[int]) -> list[tuple[int, ...]]:
    """The samples in which buses come nearest to a limit with a site of these sizes, in steps, that nobody controls.

    They are found without control, and every controller is tried in them first.
    """
    by_size = dict[int, list[int]]()
    for i, size in enumerate(sizes):
        by_size.setdefault(size, []).append(i)
    critical: list[tuple[int, ...]] = [()] * len(buses)
    for size, bus_positions in by_size.items():
        bus_samples = [(int(buses[i]), np.arange(len(site.windows))) for i in bus_positions]
        for i, trial in zip(bus_positions, trials(site, NoControl(), size, bus_samples, SNAPSHOT), strict=True):
            critical[i] = tuple(worst_samples(trial).tolist())
    return critical


def _shared_out(n: int, parts: int) -> list[np.ndarray]:
    return [part for part in np.array_split(np.arange(n), min(parts, n)) if len(part)]


def _span(bus_ids: Sequence[str], buses: Sequence[int] | np.ndarray) -> str:
    return f"{bus_ids[buses[0]]} to {bus_ids[buses[-1]]}"


def _snapshots(buses: np.ndarray) -> list[tuple[BusCapacity, list[float]]]:
    return snapshots(shared(_STUDY), buses, shared(_EXEMPT))


def _work(task: _Task) -> list[BusCapacity]:
    study = shared(_STUDY)
    controller, _ = study_controller(task.controller, study.scenario, task.tuned)
    buses, guesses, critical, snapshot = zip(*task.requests, strict=True)
    # Nothing but control can make more room than a power flow of the worst hour shows.
    bounded = task.controller == UNCONTROLLED and not study.allowed_pct
    return search_buses(
        AddedSite(study, shared(_WINDOWS), shared(_EXEMPT)),
        controller,
        task.controller,
        np.array(buses),
        np.array(guesses),
        [np.array(samples) for samples in critical],
        snapshot if bounded else None,
    )
