"""The presets of what data centres have beside clock and queue; docs/scenarios.md says what they are for."""

from __future__ import annotations

from dcgrid_env.devices.datacenter.service_levels import ServiceLevels
from dcgrid_env.devices.datacenter.work_routing import Routing
from dcgrid_env.scenario.cost import CostWeights
from dcgrid_env.scenario.presets_balanced import bursty
from dcgrid_env.scenario.scenario import Scenario


def routing() -> Scenario:
    """Make the preset ``routing``."""
    # Sizes were chosen on validation, so that no site is always the strongest. Waiting within a deadline is free. Half
    # the steps of others make hindsight, which has many more unknowns here, a third as long.
    return bursty().replace(
        name="routing",
        n_datacenters=4,
        datacenter_buses=(18, 33, 25, 12),
        datacenter_routing=Routing(movable_share=0.5, move_latency_s=0.1),
        datacenter_service=ServiceLevels(target_s=2.0, deadline_s=20.0, interactive_share=0.6),
        horizon=60,
        weights=CostWeights(backlog=0.0),
    )
