"""Find the capacities of buses under one controller: searches run in parallel, with one batch for each size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dcgrid_env import Feeder, Scenario, fcfs_delays
from dcgrid_env.apps.hosting.added_site import AddedSite
from dcgrid_env.apps.hosting.bus_search import BusSearch, Request
from dcgrid_env.apps.hosting.element_names import branch_to
from dcgrid_env.apps.hosting.trial import (
    COLLAPSED,
    LIMITS,
    LOSS,
    OVERLOAD,
    TAPS,
    UNLIMITED,
    Trial,
    run_trial,
    trials,
)
from dcgrid_env.baselines.controller import Controller
from dcgrid_env.grid import AnyFeeder

_FEW = 0.05
"""Share of the windows in which ``most_windows_mw`` may break limits."""
_DIGITS = 4
"""Decimals of interpolated sizes in MW; the power flow's tolerance shows in the ninth."""


@dataclass(frozen=True)
class BusCapacity:
    """Capacity of one bus under one controller, with the delay of the site's work."""

    controller: str
    bus: str
    capacity_mw: float
    """Largest size that stays within the limits, MW; the next one, a step larger, does not."""
    at_most: bool
    """Whether it is the largest size that was tried, so that a larger one may be feasible."""
    limit: str
    """Limit that the next size breaks, one of ``LIMITS``, with its location; empty if ``at_most``."""
    delay_mean_s: float
    delay_p95_s: float
    """Waiting time of the site's work at that size, weighted by work, over all samples, s."""
    unserved_pct: float
    """Share of the site's arriving work that was still queued at the end of the windows, %."""
    outside_pct: float
    """Share of the seconds of all windows with a broken limit at that size, %."""
    margin: float
    """Least margin to a limit at that size, see ``Trial.margin``."""
    most_windows_mw: float
    """Size that stays within the limits in 95 % of the sampled windows, MW."""
    half_windows_mw: float
    """Size that stays within the limits in half of the sampled windows, MW. Both are interpolated between the margins
    of each window at no site and at the capacity, rounded to 0.1 kW, and at most the largest size that was tried."""
    smaller_fails_mw: tuple[float, ...]
    """Smaller sizes of the coarse scan that break limits, MW; if there are any, not every size below the capacity is
    feasible."""
    larger_carries_mw: tuple[float, ...]
    """Larger sizes of the coarse scan that stay within the limits, MW."""


def search_buses(
    site: AddedSite,
    controller: Controller,
    name: str,
    buses: np.ndarray,
    guesses: np.ndarray,
    critical: Sequence[np.ndarray],
    snapshot: Sequence[BusCapacity] | None = None,
) -> list[BusCapacity]:
    """Find the capacity of buses under one controller.

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
    snapshot
        Largest results at the buses; None for none.

    Raises
    ------
    ControllerError
        Where the controller fails or cannot drive such a scenario.
    """
    return [result for result, _ in searched(site, controller, name, buses, guesses, critical, snapshot)]


def searched(
    site: AddedSite,
    controller: Controller,
    name: str,
    buses: np.ndarray,
    guesses: np.ndarray,
    critical: Sequence[np.ndarray],
    snapshot: Sequence[BusCapacity] | None = None,
) -> list[tuple[BusCapacity, int | None]]:
    """Return the results of ``search_buses``, each with the window that limits the next size; None for none."""
    study, feeder = site.study, site.study.scenario.feeder
    samples = np.arange(len(site.windows))
    before = [overloaded_before(feeder, bus, site.exempt) for bus in buses]
    empty = run_trial(site, controller, 0, np.full(len(samples), buses[0]), samples, name)
    # Without a site of any size there is nothing to search where limits are broken already.
    allowed = study.allowed_seconds(len(samples))
    fails = int(empty.outside.sum()) > allowed
    scan = tuple(sorted({study.top >> i for i in range(study.top.bit_length())}))
    tops = [study.top] * len(buses)
    if snapshot is not None:
        tops = [round(capacity.capacity_mw / study.step_mw) for capacity in snapshot]
    searches = [
        BusSearch(empty, site_limit, int(guess), top, allowed, scan)
        for guess, site_limit, top in zip(guesses, critical, tops, strict=True)
    ]
    left = {i: search for i, search in enumerate(searches) if not (fails or before[i]) and tops[i]}
    while left:
        by_size: dict[int, list[tuple[int, Request]]] = {}
        for i, search in list(left.items()):
            request = search.next()
            if request is None:
                del left[i]
            else:
                by_size.setdefault(request.size, []).append((i, request))
        for size, requests in by_size.items():
            of_buses = [(int(buses[i]), request.samples) for i, request in requests]
            for (i, request), trial in zip(requests, trials(site, controller, size, of_buses, name), strict=True):
                searches[i].take(request, trial)
    results = []
    for i, (bus, search) in enumerate(zip(buses, searches, strict=True)):
        beyond, limit = search.beyond, "" if snapshot is None else snapshot[i].limit
        if fails:
            beyond = empty
        elif before[i]:
            limit = before[i]
        if beyond is not None and (fails or not before[i]):
            limit = limit_of(study.scenario, beyond)
        limiting = int(empty.margins.min(axis=1).argmin()) if fails else search.limiting
        results.append((_capacity(site, name, bus, search, limit, empty), limiting))
    return results


def overloaded_before(feeder: AnyFeeder, bus: int, overloaded: np.ndarray) -> str:
    """Name the nearest branch before a bus that is overloaded without any site; empty for none."""
    while bus > 0:
        for node in np.flatnonzero(overloaded[: feeder.n_node] & (np.asarray(feeder.node_bus) == bus)):
            return f"overload of {branch_to(feeder, int(node))} without any site"
        bus = int(feeder.parent[bus - 1])
    return ""


def _window_capacities_mw(site: AddedSite, empty: Trial, size: int, at_size: Trial) -> np.ndarray:
    """The largest site that each window alone would carry, MW, (sample,), not less than the capacity of all."""
    capacity_mw, largest_mw = site.mw(size), site.mw(site.study.top)
    if not size:
        return np.zeros(len(empty.outside))
    fall = empty.margins - at_size.margins
    falls = (fall > 1e-9) & (empty.margins < UNLIMITED)
    shares = np.where(falls, np.maximum(empty.margins, 0.0) / np.where(falls, fall, 1.0), np.inf).min(axis=1)
    return np.clip(shares * capacity_mw, capacity_mw, largest_mw)


def _capacity(site: AddedSite, name: str, bus: int, search: BusSearch, limit: str, empty: Trial) -> BusCapacity:
    study, trial = site.study, search.at_size
    feeder = study.scenario.feeder
    outside_pct = 100.0 * float(trial.outside.sum()) / (len(trial.outside) * (study.horizon - study.settled))
    sampled = ~site.windows.still if site.windows.sampled else slice(None)
    trial, empty = trial.select(sampled), empty.select(sampled)
    delays = fcfs_delays(trial.arrived_kw.T, trial.served_kw.T, study.scenario.dt_s)
    sited = search.size > 0
    of_windows = _window_capacities_mw(site, empty, search.size, trial)
    return BusCapacity(
        controller=name,
        bus=feeder.bus_ids[bus],
        capacity_mw=site.mw(search.size),
        at_most=search.size == study.top and not limit,
        limit=limit,
        delay_mean_s=delays.mean_s if sited else 0.0,
        delay_p95_s=delays.p95_s if sited else 0.0,
        unserved_pct=100.0 * delays.unserved_kws / delays.arrived_kws if sited and delays.arrived_kws else 0.0,
        outside_pct=outside_pct,
        margin=search.at_size.margin,
        most_windows_mw=round(float(np.quantile(of_windows, _FEW)), _DIGITS),
        half_windows_mw=round(float(np.median(of_windows)), _DIGITS),
        smaller_fails_mw=tuple(map(site.mw, search.smaller_fails)),
        larger_carries_mw=tuple(map(site.mw, search.larger_carries)),
    )


def limit_of(scenario: Scenario, beyond: Trial) -> str:
    """Find the limit that a size breaks most, and its location."""
    row, kind = np.unravel_index(np.argmin(beyond.margins), beyond.margins.shape)
    if beyond.margin <= COLLAPSED:
        return "no power-flow solution"
    return limit_at(scenario, int(kind), int(beyond.nodes[row, kind]))


def limit_at(scenario: Scenario, kind: int, node: int) -> str:
    """Name one of ``LIMITS`` with its location, of which ``Trial.nodes`` has the position."""
    feeder: Any = scenario.feeder
    if kind == OVERLOAD:
        return f"overload of {branch_to(feeder, node)}"
    if kind == TAPS:
        return f"taps of regulator {feeder.network.regulator.name[node]}"
    if kind == LOSS:
        return LIMITS[kind]
    return f"{LIMITS[kind]} at {'bus' if isinstance(feeder, Feeder) else 'node'} {feeder.node_ids[node]}"
