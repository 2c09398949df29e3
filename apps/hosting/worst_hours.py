"""The capacity of buses in one power flow of every hour, and the hours that are worst with the site.

The search for a size goes through the hours that are worst without the site (``load_hours``). A power flow of every
hour with the site at the size found then checks the result. Where it breaks a limit, the worst hours are added to the
search of that bus, until no hour breaks a limit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from dcgrid_env.apps.hosting.added_site import AddedSite
from dcgrid_env.apps.hosting.capacity_study import Study
from dcgrid_env.apps.hosting.load_hours import (
    Windows,
    load_hours,
    window_begins,
    with_same_hours,
    with_worst_hours,
)
from dcgrid_env.apps.hosting.site_scenario import still_fields
from dcgrid_env.apps.hosting.site_search import BusCapacity, searched
from dcgrid_env.apps.hosting.trial import (
    OVERLOAD,
    ROUNDING,
    UNDERVOLTAGE,
    UNLIMITED,
    hour_margins,
    overloaded_nodes,
)
from dcgrid_env.baselines.laws.no_control import NoControl

SNAPSHOT = "snapshot"
"""Name of the capacity of one power flow in place of a controller's name."""
_DIGITS = 7
"""Decimals of margins in which hours differ; of equal hours the first one counts."""


def snapshot_capacity(study: Study, buses: np.ndarray) -> list[BusCapacity]:
    """What buses (positions in ``bus_ids``, (n,)) carry in one power flow of every hour.

    Data centres draw their rating at a power factor of one. Other loads and PV are those of the hour, without noise.
    Nothing is controlled except equipment of the feeder, which has settled. With ``load = "peak"``, there is one
    power flow at nominal load, in which inverters give what they do at noon.
    """
    return [capacity for capacity, _ in snapshots(study, buses, exempt(study))]


def exempt(study: Study) -> np.ndarray:
    """Return the branches that are overloaded without any site in some hour; see ``overloaded_nodes``."""
    moment = moment_of(study)
    return overloaded_nodes(AddedSite(moment, moments(moment, load_hours(study).hours)))


def snapshots(study: Study, buses: np.ndarray, exempt: np.ndarray) -> list[tuple[BusCapacity, list[float]]]:
    """Return the results of ``snapshot_capacity``, each with the hours that are worst with a site of that size, h."""
    extremes, moment = load_hours(study), moment_of(study)
    results: dict[int, tuple[BusCapacity, list[float]]] = {}
    every = AddedSite(moment, moments(moment, extremes.every), exempt)
    searches = [(np.arange(len(buses)), extremes.hours.tolist())]
    while searches:
        positions, hours = searches.pop()
        site = AddedSite(moment, moments(moment, np.array(hours)), exempt)
        first = np.r_[: max(1, len(extremes.named())), len(extremes.hours) : len(hours)]
        guesses = np.full(len(positions), max(1, math.isqrt(study.top)))
        capacities = searched(site, NoControl(), SNAPSHOT, buses[positions], guesses, [first] * len(positions))
        for i, (capacity, limiting) in zip(positions.tolist(), capacities, strict=True):
            size = round(capacity.capacity_mw / study.step_mw)
            worst, broken = worst_hours(every, size, int(buses[i])) if size else ([], [])
            if limiting is not None and hours[limiting] not in worst:
                worst.append(hours[limiting])
            results[i] = capacity, worst
            if missed := [hour for hour in broken if hour not in hours]:
                searches.append((np.array([i]), [*hours, *missed]))
    return [results[i] for i in range(len(buses))]


def worst_hours(every: Any, size: Any, bus: int) -> tuple[list[float], list[float]]:
    """Return the hours that are worst with a site, and those of them in which a limit is broken, h.

    Parameters
    ----------
    every
        An ``AddedSite``, or what stands for several, whose windows are ``moments`` of every hour.
    size, bus
        Size of the site in steps, and the position of its bus.
    """
    hours = load_hours(every.study).every
    margins = hour_margins(every, size, bus)
    rounded = np.round(margins, _DIGITS)
    limits = [rounded.min(axis=1), *(rounded[:, kind] for kind in (UNDERVOLTAGE, OVERLOAD))]
    nearest = dict.fromkeys(int(distances.argmin()) for distances in limits if distances.min() < UNLIMITED)
    return [float(hours[i]) for i in nearest], [float(hours[i]) for i in nearest if margins[i].min() < -ROUNDING]


def moment_of(study: Study) -> Study:
    """Return the study whose windows are moments without noise, in which all sites draw their rating."""
    return with_same_hours(
        study, scenario=study.scenario.replace(**still_fields(study)), samples=1, window_s=2.0 * study.scenario.dt_s,
        settle_s=0.0, allowed_pct=0.0,
    )  # fmt: skip


def moments(moment: Study, hours: np.ndarray) -> Windows:
    """Return the windows of a study of moments at some hours, h."""
    begin_h = None if moment.load == "peak" else window_begins(moment, hours)
    return Windows(begin_h, hours, ("a power flow",) * len(hours), len(hours))


def reasons(buses: Sequence[str], worst: Sequence[Sequence[float]]) -> dict[float, str]:
    """Return the reasons of the hours that are worst with a site at each of some buses, by hour."""
    buses_by_hour: dict[float, list[str]] = {}
    for bus, hours in zip(buses, worst, strict=True):
        for hour in hours:
            buses_by_hour.setdefault(hour, []).append(bus)
    return {
        hour: f"worst with the site at {f'bus {ids[0]}' if len(ids) == 1 else f'{len(ids)} buses, such as {ids[0]}'}"
        for hour, ids in buses_by_hour.items()
    }


def study_windows(study: Study, bus: int, size: int) -> Windows:
    """Return the windows for a site at a bus: the sampled ones, and those at the hours that are worst or limit it.

    They include the worst hours with a site of ``size`` steps, next to those with a site of the size that fits.
    """
    overloaded, moment = exempt(study), moment_of(study)
    ((_, hours),) = snapshots(study, np.array([bus]), overloaded)
    sized, _ = worst_hours(AddedSite(moment, moments(moment, load_hours(study).every), overloaded), size, bus)
    worst = list(dict.fromkeys((*hours, *sized)))
    return with_worst_hours(study, reasons([str(study.scenario.feeder.bus_ids[bus])], [worst]))
