"""Scenarios whose sites move work, batch it and serve it by deadlines."""

from typing import Any

from dcgrid_env import Scenario, make_scenario


def routed(name: str = "ieee33", **changes: Any) -> Scenario:
    """A preset under bursts of requests, its sites with routing, batches and service levels."""
    given = {
        "trace": "code",
        "horizon": 40,
        "datacenters.routing": {"movable_share": 0.8, "move_latency_s": 0.2},
        "datacenters.batching": {},
        "datacenters.service": {"target_s": 2.0, "deadline_s": 12.0},
    }
    return make_scenario(name, **given).replace(**changes)
