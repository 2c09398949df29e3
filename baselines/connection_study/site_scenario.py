"""The scenarios of a connection study: the feeder with and without the requested site."""

from __future__ import annotations

from typing import Any

from dcgrid_env import Scenario
from dcgrid_env.baselines.hosting_capacity.capacity_study import Study

_NOTHING_KW = 1e-3
"""Rating that represents the absence of the site, since the rating of a device must be positive."""


def with_site(study: Study, bus: str, mw: float, **changes: Any) -> Scenario:
    """The study's scenario with a site of a rating at a bus, or without it for 0 MW, and other changes."""
    base, others = study.scenario, study.others
    there = base.datacenters.buses or () if others else ()
    ratings = base.datacenters.parameters.p_rated_kw.tolist()[: len(there)]
    changed: dict[str, Any] = {
        "n_datacenters": len(there) + 1,
        "datacenters.buses": (*map(str, there), bus),
        "datacenters.p_rated_kw": (*ratings, 1000.0 * mw if mw else _NOTHING_KW),
    }
    if not others:
        changed |= {"inverters.buses": (), "inverters.s_rated_kva": 0.0}
    return base.replace(**changed, **changes)
