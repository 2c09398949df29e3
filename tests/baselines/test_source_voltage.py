"""The substation voltage that centres the band."""

import numpy as np
import pytest

from dcgrid_env import load_feeder, scenario_on
from dcgrid_env.baselines import NoControl, centred_voltage, rollout
from dcgrid_env.baselines.source_voltage import TAP_PU


@pytest.mark.parametrize("name", ["ieee123", "das69", "toy6"])
def test_the_mean_voltages_reach_as_far_up_as_down(name):
    scenario = scenario_on(load_feeder(name))
    found = centred_voltage(scenario, episodes=4)
    assert not found.is_own
    assert (found.v_pu - 1.0) / TAP_PU == pytest.approx(round((found.v_pu - 1.0) / TAP_PU), abs=1e-9)
    recorder = rollout(scenario.replace(source_voltage_pu=found.v_pu, split="train"), NoControl(), range(4))
    mean = np.mean([recorder.series(i).v_pu[1:, 1:].mean(axis=0) for i in range(4)], axis=0)
    assert (found.lowest_pu, found.highest_pu) == pytest.approx((mean.min(), mean.max()))
    assert abs(0.5 * (mean.min() + mean.max()) - 1.0) <= 0.75 * TAP_PU


def test_a_weak_feeder_gets_the_top_of_the_band_and_costs_less_there():
    scenario = scenario_on(load_feeder("ieee33"), "3 x 1 MW at ends")
    found = centred_voltage(scenario, episodes=2)
    assert found.v_pu == pytest.approx(1.05)
    assert found.highest_pu < 1.05
    costs = {v: rollout(scenario.replace(source_voltage_pu=v), NoControl(), range(2)).costs().mean() for v in (1, 1.05)}
    assert costs[1.05] < 0.3 * costs[1]


def test_a_feeder_that_regulators_hold_keeps_its_own():
    scenario = scenario_on(load_feeder("ieee13-3ph"))
    assert centred_voltage(scenario, episodes=1).v_pu == scenario.source_voltage_pu
    fixed = scenario.replace(grid_control={"regulators": "fixed"})
    assert not centred_voltage(fixed, episodes=1).is_own
