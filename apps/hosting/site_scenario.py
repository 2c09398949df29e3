"""The scenarios of a study with further data centres, or without them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from dcgrid_env import Scenario
from dcgrid_env.apps.hosting.capacity_study import Study
from dcgrid_env.traces import PowerTrace

_NOTHING_KW = 1e-3
"""Rating that represents the absence of a site, since the rating of a device must be positive."""


def free_bus(study: Study) -> tuple[str] | None:
    """Return a bus without a device, for a site whose bus each reset sets; None if all buses are drawn."""
    scenario, others = study.scenario, study.others
    if others and scenario.datacenters.buses is None:
        return None
    taken = {str(bus) for device in scenario.devices for bus in getattr(device, "buses", None) or () if others}
    free = [bus for bus in scenario.feeder.bus_ids[1:] if bus not in taken]
    if not free:
        raise ValueError(f"scenario {scenario.name!r} has a device at every bus; leave one bus without")
    return (free[0],)


def still_fields(study: Study) -> dict[str, Any]:
    """Return the fields of a scenario whose sites draw their rating all the time, next to loads without noise."""
    dt_s = float(study.scenario.dt_s)
    full = PowerTrace([0.0, 60.0 * dt_s], [1.0, 1.0], "full load", compute_kw=[1.0, 1.0])
    return {"trace": (full,), "background.load_sigma": 0.0, "workload.site_correlation": 0.0}


def with_sites(study: Study, buses: Sequence[str] | None, mw: Sequence[float], **changes: Any) -> Scenario:
    """Return the study's scenario with further data centres, which follow those of the scenario.

    Parameters
    ----------
    study
        The study. Without ``others``, the further data centres are the only devices.
    buses
        Bus of each further data centre; None if the buses of all data centres are drawn in each episode.
    mw
        Rating of each, MW; 0 for none.
    changes
        Other fields that change.

    Raises
    ------
    ValueError
        If the scenario draws the buses of its data centres, and ``buses`` are given.
    """
    base, others = study.scenario, study.others
    there = base.datacenters.buses if others else ()
    if there is None and buses is not None:
        raise ValueError(
            f"scenario {base.name!r} draws the buses of its data centres in each episode; give them with "
            "datacenters.buses"
        )
    ratings = base.datacenters.parameters.p_rated_kw.tolist() if others else []
    changed: dict[str, Any] = {
        "n_datacenters": len(ratings) + len(mw),
        "datacenters.buses": None if there is None or buses is None else (*map(str, there), *buses),
        "datacenters.p_rated_kw": (*ratings, *(1000.0 * size if size else _NOTHING_KW for size in mw)),
    }
    if not others:
        changed |= {"inverters.buses": (), "inverters.s_rated_kva": 0.0}
    return base.replace(**changed, **changes)
