"""A scenario for a feeder that has none: data centres and inverters of a size that suits its load."""

from __future__ import annotations

import numpy as np

from dcgrid_env.devices import DataCenters
from dcgrid_env.grid import AnyFeeder, Feeder
from dcgrid_env.scenario.errors import ScenarioError
from dcgrid_env.scenario.placement import free_load_buses
from dcgrid_env.scenario.scenario import Scenario

SITES, SITES_SHARE = 5, 0.4
"""Data centres, and what they draw together as a share of the feeder's load; both as in the paper's study."""
S_RATED_SHARE, Q_MAX_SHARE = 1.1, 0.33
INVERTERS, INVERTERS_SHARE = 7, 0.1
"""Inverters, and their ratings together as a share of the feeder's load; both as in the paper's study."""


def scenario_on(feeder: AnyFeeder) -> Scenario:
    """Choose a scenario for a feeder, in the proportions of the paper's study.

    Data centres are drawn among the load buses, of three phases where there are phases; inverters stand at load buses
    spread evenly over the feeder, on all phases of their bus. A small feeder has fewer of both. The source's voltage is
    the feeder's, regulators follow their own controls, all else is at its default.

    Raises
    ------
    ScenarioError
        For a feeder without a load bus where a data centre could be drawn.
    """
    drawn = DataCenters(count=1, p_rated_kw=1.0, s_rated_share=S_RATED_SHARE, q_max_share=Q_MAX_SHARE)
    loads = free_load_buses(feeder, ()).tolist()
    pool = set(free_load_buses(feeder, (drawn,)).tolist())
    if not pool:
        kind = "" if isinstance(feeder, Feeder) else " of three phases"
        raise ScenarioError(
            f"feeder {feeder.name!r} has no load bus{kind} where a data centre could be drawn; write a scenario that "
            "says where devices stand (docs/scenarios.md)"
        )
    sites = min(SITES, (len(pool) + 1) // 2)
    inverters = _spread(loads, pool, min(INVERTERS, len(loads) - sites), sites)
    load_kw = base_load_kw(feeder)
    return Scenario(
        name=f"on-{feeder.name}",
        feeder=feeder,
        source_voltage_pu=feeder.v0_pu,
        power_flow=power_flow_of(feeder),
        n_datacenters=sites,
        p_rated_kw=_round(SITES_SHARE * load_kw / sites),
        s_rated_share=S_RATED_SHARE,
        q_max_share=Q_MAX_SHARE,
        inverter_buses=tuple(feeder.bus_ids[i] for i in inverters),
        inverter_s_kva=_round(INVERTERS_SHARE * load_kw / max(1, len(inverters))),
    )


def power_flow_of(feeder: AnyFeeder) -> str:
    """The nonlinear power flow of the feeder's kind."""
    return "distflow" if isinstance(feeder, Feeder) else "sweep"


def base_load_kw(feeder: AnyFeeder) -> float:
    """Active power of all loads in the base case, kW."""
    return float(feeder.p_load_kw.sum())


def _spread(loads: list[int], pool: set[int], n: int, kept: int) -> list[int]:
    """Up to ``n`` load buses spread evenly, which leave ``kept`` of the pool that data centres are drawn from."""
    chosen: list[int] = []
    spare = len(pool) - kept
    for i in np.unique(np.linspace(0, len(loads) - 1, max(n, 0)).round().astype(int)):
        if loads[i] in pool:
            if not spare:
                continue
            spare -= 1
        chosen.append(loads[i])
    return chosen


def _round(value: float) -> float:
    """To two digits, as ratings are."""
    return float(f"{value:.2g}")
