"""The capacities of buses under one controller: all searches side by side, and a batch for all that try one size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dcgrid_env import Feeder, Scenario, fcfs_delays
from dcgrid_env.baselines.controller import Controller
from dcgrid_env.baselines.hosting_capacity.added_site import AddedSite
from dcgrid_env.baselines.hosting_capacity.bus_search import BusSearch, Request
from dcgrid_env.baselines.hosting_capacity.trial import COLLAPSED, LIMITS, OVERLOAD, Trial, run_trial, trials


@dataclass(frozen=True)
class BusCapacity:
    """What one bus carries under one controller, and at which price."""

    controller: str
    bus: str
    capacity_mw: float
    """The largest size that keeps within the limits; the next one tried, a step larger, does not."""
    at_most: bool
    """Whether it is the largest size that was tried, so that more might be carried."""
    limit: str
    """What the next size breaks: one of ``LIMITS``, with where; empty where ``at_most``."""
    delay_mean_s: float
    delay_p95_s: float
    """Waiting time of the site's work at that size, weighted by work, over all samples."""
    unserved_pct: float
    """Share of the work that arrived at the site that was still queued at the end of the windows."""
    outside_pct: float
    """Share of the sampled seconds in which some limit was broken at that size."""
    asked_max_pct: float
    """The most that the site's work asks for in the samples, % of its rating: a size is found for that draw."""
    margin: float
    """Least distance to a limit at that size, ``Trial.margin``."""
    smaller_fails_mw: tuple[float, ...]
    """Smaller sizes of the coarse scan that break limits: capacity is then no bound below which all is well."""
    larger_carries_mw: tuple[float, ...]
    """Larger sizes of the coarse scan that keep within the limits."""


def search_buses(
    site: AddedSite,
    controller: Controller,
    name: str,
    buses: np.ndarray,
    guesses: np.ndarray,
    critical: Sequence[np.ndarray],
    on_bus: Callable[[], None] | None = None,
) -> list[BusCapacity]:
    """Find what buses carry.

    Parameters
    ----------
    site
        The study's added site.
    controller, name
        What drives the agents, and what errors call it.
    buses
        Positions in ``bus_ids`` of the candidates, (n,).
    guesses
        The size to try first at each, in steps, (n,).
    critical
        Numbers of the samples to try first at each.
    on_bus
        Called as each bus is done (for progress).

    Raises
    ------
    ControllerError
        Where the controller fails or cannot drive such a scenario.
    """
    study = site.study
    samples = np.arange(study.samples)
    empty = run_trial(site, controller, 0, np.full(study.samples, buses[0]), samples, name)
    # Without a site of any size there is nothing to search where limits are broken already.
    fails = int(empty.outside.sum()) > study.allowed_seconds
    scan = tuple(sorted({study.top >> i for i in range(study.top.bit_length())}))
    searches = [
        BusSearch(empty, own, int(guess), 0 if fails else study.top, study.allowed_seconds, scan)
        for guess, own in zip(guesses, critical, strict=True)
    ]
    left = dict(enumerate(searches))
    while left:
        by_size: dict[int, list[tuple[int, Request]]] = {}
        for i, search in list(left.items()):
            request = None if fails else search.next()
            if request is None:
                del left[i]
                if on_bus is not None:
                    on_bus()
            else:
                by_size.setdefault(request.size, []).append((i, request))
        for size, asked in by_size.items():
            of_buses = [(int(buses[i]), request.samples) for i, request in asked]
            for (i, request), trial in zip(asked, trials(site, controller, size, of_buses, name), strict=True):
                searches[i].take(request, trial)
    return [
        _capacity(site, name, bus, search, empty if fails else search.beyond)
        for bus, search in zip(buses, searches, strict=True)
    ]


def _capacity(site: AddedSite, name: str, bus: int, search: BusSearch, beyond: Trial | None) -> BusCapacity:
    study, trial = site.study, search.at_size
    feeder = study.scenario.feeder
    delays = fcfs_delays(trial.arrived_kw.T, trial.served_kw.T, study.scenario.dt_s)
    counted = study.samples * (study.horizon - study.settled)
    sited = search.size > 0
    return BusCapacity(
        controller=name,
        bus=feeder.bus_ids[bus],
        capacity_mw=site.mw(search.size),
        at_most=search.size == study.top,
        limit="" if beyond is None else _limit(study.scenario, beyond),
        delay_mean_s=delays.mean_s if sited else 0.0,
        delay_p95_s=delays.p95_s if sited else 0.0,
        unserved_pct=100.0 * delays.unserved_kws / delays.arrived_kws if sited and delays.arrived_kws else 0.0,
        outside_pct=100.0 * float(trial.outside.sum()) / counted,
        asked_max_pct=_asked_max_pct(site, search.size, trial) if sited else 0.0,
        margin=trial.margin,
        smaller_fails_mw=tuple(map(site.mw, search.smaller_fails)),
        larger_carries_mw=tuple(map(site.mw, search.larger_carries)),
    )


def _asked_max_pct(site: AddedSite, size: int, trial: Trial) -> float:
    own = site.scenario(size).datacenter
    return 100.0 * float((trial.arrived_kw.max() + own.p_idle_kw[site.slot]) / own.p_rated_kw[site.slot])


def _limit(scenario: Scenario, beyond: Trial) -> str:
    """What a size breaks worst, and where."""
    lane, kind = np.unravel_index(np.argmin(beyond.margins), beyond.margins.shape)
    at, feeder = int(beyond.at[lane, kind]), scenario.feeder
    if beyond.margin <= COLLAPSED:
        return "no power-flow solution"
    node = feeder.node_ids[at]
    if kind == OVERLOAD:
        return f"overload of the branch from {feeder.bus_ids[feeder.parent[feeder.node_bus[at] - 1]]} to {node}"
    return f"{LIMITS[kind]} at {'bus' if isinstance(feeder, Feeder) else 'node'} {node}"
