"""The presets of data-centre features other than clock and queue; docs/scenarios.md describes their purpose."""

from __future__ import annotations

from dcgrid_env.devices.datacenter.power_smoothing import PowerSmoothing
from dcgrid_env.devices.datacenter.service_levels import ServiceLevels
from dcgrid_env.devices.datacenter.work_routing import Routing
from dcgrid_env.scenario.cost import CostWeights
from dcgrid_env.scenario.presets_balanced import bursty, ieee33_weak, training
from dcgrid_env.scenario.scenario import Scenario


def smoothing() -> Scenario:
    """Make the preset ``smoothing``.

    Its limits and weights were chosen on the validation split (docs/smoothing.md): without smoothing ramps and flicker
    are bad, the highest floor burns too much, and the best floor lies between.
    """
    return training().replace(
        name="smoothing",
        horizon=6000,
        datacenters={
            "smoothing": PowerSmoothing(
                floor_share=0.9,
                ramp_up_w_per_s=12_000.0,
                ramp_down_w_per_s=12_000.0,
                hysteresis_s=2.0,
                control="agent",
                change_every_s=10.0,
                burnt_weight=3.0,
            )
        },
        cost={"ramp_limit_kw_per_s": 60.0, "ramp_window_s": 1.0, "voltage_step_limit_pu": 0.01},
        weights=CostWeights(leftover=90.0, ramp_excess=1.0, voltage_step_excess=10.0),
    )


def routing() -> Scenario:
    """Make the preset ``routing``."""
    # Sizes were chosen on validation, so that no site is always the strongest. Waiting within a deadline is free. Half
    # the steps of others make hindsight, which has many more unknowns here, a third as long.
    return bursty().replace(
        name="routing",
        n_datacenters=4,
        datacenters={
            "buses": (18, 33, 25, 12),
            "routing": Routing(movable_share=0.5, move_latency_s=0.1),
            "service": ServiceLevels(target_s=2.0, deadline_s=20.0, interactive_share=0.6),
        },
        horizon=60,
        weights=CostWeights(backlog=0.0),
    )


def load_target() -> Scenario:
    """Make the preset ``load-target``.

    docs/load-target.md says why it has these numbers.
    """
    return ieee33_weak().replace(
        name="load-target",
        datacenters={"p_rated_kw": 600.0},
        trace="mixed",
        grid_request={
            "targets": [
                {"value_share": (0.38, 0.46), "begin_s": (30.0, 45.0), "ramp_s": 10.0, "duration_s": (40.0, 50.0)}
            ],
            "notice_s": 20.0,
        },
        weights={"grid_request": 30.0},
    )
