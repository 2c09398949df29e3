"""The presets of what stands between chips and grid at a site; docs/scenarios.md says what they are for."""

from __future__ import annotations

from dcgrid_env.devices.datacenter.power_smoothing import PowerSmoothing
from dcgrid_env.scenario.cost import CostWeights
from dcgrid_env.scenario.presets_balanced import training
from dcgrid_env.scenario.scenario import Scenario


def smoothing() -> Scenario:
    """Make the preset ``smoothing``.

    Its limits and weights were chosen on the validation split (docs/smoothing.md): without smoothing ramps and flicker
    are bad, the highest floor burns too much, and what is best lies between.
    """
    return training().replace(
        name="smoothing",
        horizon=6000,
        datacenter_smoothing=PowerSmoothing(
            floor_share=0.9,
            ramp_up_w_per_s=12_000.0,
            ramp_down_w_per_s=12_000.0,
            hysteresis_s=2.0,
            control="agent",
            change_every_s=10.0,
            burnt_weight=3.0,
        ),
        ramp_limit_kw_per_s=60.0,
        ramp_window_s=1.0,
        voltage_step_limit_pu=0.01,
        weights=CostWeights(leftover=90.0, ramp_excess=1.0, voltage_step_excess=10.0),
    )
