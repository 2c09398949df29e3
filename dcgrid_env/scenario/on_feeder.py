"""Scenario for any feeder: data centres and inverters as requested, or sized by the feeder's load."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any

import numpy as np

from dcgrid_env.devices import DataCenters
from dcgrid_env.grid import AnyFeeder, Feeder
from dcgrid_env.scenario.errors import ScenarioError
from dcgrid_env.scenario.group_notation import DATA_CENTRES, DRAWN, ENDS, INVERTERS, Notation, Part, read_group
from dcgrid_env.scenario.placement import feeder_ends, free_load_buses
from dcgrid_env.scenario.scenario import Scenario

SITES, SITES_SHARE = 5, 0.4
"""Number of data centres, and their total draw as a share of the feeder's load; both as in the paper's study."""
S_RATED_SHARE, Q_MAX_SHARE = 1.1, 0.33
INVERTERS_COUNT, INVERTERS_SHARE = 7, 0.1
"""Number of inverters, and their total rating as a share of the feeder's load; both as in the paper's study."""


def scenario_on(feeder: AnyFeeder, datacenters: str | None = None, inverters: str | None = None) -> Scenario:
    """Make a scenario for a feeder.

    The source's voltage is the feeder's, regulators follow their own controls, all else is at its default.

    Parameters
    ----------
    feeder
        Any feeder with a load.
    datacenters, inverters
        Devices in words, such as ``"3 x 1 MW at ends"`` and ``"5 x 200 kvar"``, see ``group_notation``. The default is
        up to five data centres, 40 % of the load together, drawn among the load buses (with three phases if the feeder
        has phases). Up to seven inverters, 10 % of the load together, are spread evenly over the load buses.

    Raises
    ------
    ScenarioError
        For invalid words, missing buses or ends, or a feeder without a load bus for a drawn data centre.
    """
    sites = None if datacenters is None else read_group(DATA_CENTRES, datacenters)
    others = None if inverters is None else read_group(INVERTERS, inverters)
    pool = _pool(feeder)
    if not pool and (sites is None or any(part.place == DRAWN for part in sites)):
        kind = "" if isinstance(feeder, Feeder) else " of three phases"
        raise ScenarioError(
            f"feeder {feeder.name!r} has no load bus{kind} where a data centre could be drawn; name buses, such as "
            "--datacenters '2 x 500 kW at BUS,BUS', or write a scenario with the places of devices (docs/scenarios.md)"
        )
    if sites is None:
        count = min(SITES, (len(pool) + 1) // 2)
        sites = (Part(count, _round(SITES_SHARE * base_load_kw(feeder) / count), DRAWN),)
    n_sites, drawn = sum(part.count for part in sites), any(part.place == DRAWN for part in sites)
    kept = n_sites if drawn else 0
    taken = _named(feeder, ((DATA_CENTRES, sites), (INVERTERS, others or ())))
    site_buses = None if drawn else _placed(feeder, DATA_CENTRES, sites, taken, 0)
    if others is None:
        spread = _spread(feeder, INVERTERS_COUNT, kept, taken)
        rating = _round(INVERTERS_SHARE * base_load_kw(feeder) / max(1, len(spread)))
        others = (Part(len(spread), rating, tuple(feeder.bus_ids[i] for i in spread)),) if spread else ()
    return Scenario(
        name=f"on-{feeder.name}",
        feeder=feeder,
        source_voltage_pu=feeder.v0_pu,
        power_flow=power_flow_of(feeder),
        n_datacenters=n_sites,
        datacenters={
            "buses": site_buses if sites else None,
            "p_rated_kw": _ratings(sites),
            "s_rated_share": S_RATED_SHARE,
            "q_max_share": Q_MAX_SHARE,
        },
        inverters={"buses": _placed(feeder, INVERTERS, others, taken, kept), "s_rated_kva": _ratings(others)},
    )


def power_flow_of(feeder: AnyFeeder) -> str:
    """Return the name of the nonlinear power flow for the feeder's kind."""
    return "distflow" if isinstance(feeder, Feeder) else "sweep"


def base_load_kw(feeder: AnyFeeder) -> float:
    """Return the active power of all loads in the base case, kW."""
    return float(feeder.p_load_kw.sum())


def _pool(feeder: AnyFeeder) -> set[int]:
    """Buses where a data centre can be drawn while none are taken."""
    drawn = DataCenters(count=1, p_rated_kw=1.0, s_rated_share=S_RATED_SHARE, q_max_share=Q_MAX_SHARE)
    return set(free_load_buses(feeder, (drawn,)).tolist())


def _named(feeder: AnyFeeder, groups: Iterable[tuple[Notation, tuple[Part, ...]]]) -> set[int]:
    """Return the named buses; ScenarioError for an unknown bus, the substation, or a bus named twice."""
    taken: set[int] = set()
    position = {bus: i for i, bus in enumerate(feeder.bus_ids)}
    for kind, parts in groups:
        for bus in (bus for part in parts if isinstance(part.place, tuple) for bus in part.place):
            wrong = None
            if bus not in position:
                near = difflib.get_close_matches(bus, feeder.bus_ids) or list(feeder.bus_ids[1:4])
                wrong = f"feeder {feeder.name!r} has no bus {bus!r}; it has {', '.join(near)} and "
                wrong += f"{feeder.n_bus - len(near)} more"
            elif position[bus] == 0:
                wrong = f"bus {bus!r} is the substation, where the source is; name another"
            elif position[bus] in taken:
                wrong = f"bus {bus!r} is named twice; give each device a bus of its own"
            if wrong:
                raise ScenarioError(f"{kind.option}: {wrong}")
            taken.add(position[bus])
    return taken


def _placed(
    feeder: AnyFeeder, kind: Notation, parts: tuple[Part, ...], taken: set[int], kept: int
) -> tuple[int | str, ...]:
    """Buses of the devices of all parts; those that are not named are added to ``taken``."""
    buses: list[str] = []
    for part in parts:
        if isinstance(part.place, tuple):
            buses += part.place
            continue
        if part.place == ENDS:
            allowed = np.ones(feeder.n_bus, dtype=bool)
            if kind is DATA_CENTRES and not isinstance(feeder, Feeder):  # which need three phases
                allowed = np.array([phases == "abc" for phases in feeder.bus_phases])
            allowed[[0, *taken]] = False
            chosen = feeder_ends(feeder, allowed)
            what, remedy = "ends without a device", "ask for fewer, name buses"
        else:
            chosen = _spread(feeder, part.count, kept, taken)
            what, remedy = "load buses left for them", f"ask for fewer, write '{ENDS}', name buses"
        if len(chosen) < part.count:
            raise ScenarioError(
                f"{kind.option}: {part.count} are to stand {part.place}, but feeder {feeder.name!r} has {len(chosen)} "
                f"{what}; {remedy}"
            )
        buses += (feeder.bus_ids[i] for i in chosen[: part.count])
        taken.update(chosen[: part.count])
    return tuple(buses)


def _spread(feeder: AnyFeeder, n: int, kept: int, taken: set[int]) -> list[int]:
    """Up to ``n`` load buses spread evenly, which leave ``kept`` of those that data centres are drawn from."""
    loads = [i for i in free_load_buses(feeder, ()).tolist() if i not in taken]
    pool = _pool(feeder) - taken if kept else set()
    chosen: list[int] = []
    spare = len(pool) - kept
    n = min(n, len(loads) - kept)
    for i in np.unique(np.linspace(0, len(loads) - 1, max(n, 0)).round().astype(int)):
        if loads[i] in pool:
            if spare <= 0:
                continue
            spare -= 1
        chosen.append(loads[i])
    return chosen


def _ratings(parts: tuple[Part, ...]) -> Any:
    """One rating where all are alike, else one for each device."""
    each = tuple(part.rating for part in parts for _ in range(part.count))
    return each[0] if len(set(each)) == 1 else each or 1.0


def _round(value: float) -> float:
    """Round to two significant digits, for ratings."""
    return float(f"{value:.2g}")
