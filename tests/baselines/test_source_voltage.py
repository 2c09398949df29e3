"""The source voltage: that of the file, the one that centres the band, and what is said about it."""

import numpy as np
import pytest

from dcgrid_env import load_feeder, make_scenario, read_feeder, scenario_on
from dcgrid_env.baselines import NoControl, centred_voltage, rollout
from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.baselines.source_voltage import CENTRED, TAP_PU, default_voltage, source_line, source_origin


@pytest.mark.parametrize("name", ["ieee123", "das69", "toy6"])
def test_the_mean_voltages_reach_as_far_up_as_down(name):
    scenario = scenario_on(load_feeder(name))
    found = centred_voltage(scenario, episodes=4)
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
    assert centred_voltage(fixed, episodes=1).v_pu != scenario.source_voltage_pu


def test_only_bundled_feeders_that_leave_the_band_by_themselves_are_centred(tmp_path):
    weak, strong = (scenario_on(load_feeder(name)) for name in ("ieee33", "toy6"))
    assert default_voltage(weak).source_voltage_pu == pytest.approx(1.05)
    assert default_voltage(strong).source_voltage_pu == 1.0
    load_feeder("ieee33").to_csv(tmp_path / "mine")
    assert default_voltage(scenario_on(read_feeder(tmp_path / "mine"))).source_voltage_pu == 1.0


def test_capacitors_of_a_feeder_count_in_its_lowest_voltage():
    """ieee123 has 0.923 p.u. with its 750 kvar of capacitors and 0.886 p.u. without them."""
    scenario = scenario_on(load_feeder("ieee123")).replace(cost={"band_pu": 0.1})
    assert default_voltage(scenario).source_voltage_pu == 1.0
    without = scenario.replace(background={"capacitors": False})
    assert default_voltage(without).source_voltage_pu > 1.0


def test_a_centred_voltage_can_be_asked_for_where_fields_are_overridden(tmp_path):
    load_feeder("ieee33").scaled(1.1, 1.0).to_csv(tmp_path / "mine")
    texts = (f"feeder={tmp_path / 'mine'}", "source_voltage_pu=centred")
    scenario = ScenarioSpec("ieee33", texts).make("train")
    plain = ScenarioSpec("ieee33", texts[:1]).make("train")
    assert scenario.source_voltage_pu == centred_voltage(plain).v_pu != plain.source_voltage_pu
    with pytest.raises(ValueError, match="source_voltage_pu is 'centred' on random feeders; give a number"):
        ScenarioSpec("zero-shot", texts[1:]).make("train")
    with pytest.raises(ValueError, match="source_voltage_pu is 'middle'; give a"):
        ScenarioSpec("ieee33", ("source_voltage_pu=middle",)).make("train")


def test_the_origin_of_a_voltage_is_said(tmp_path):
    load_feeder("toy6").to_csv(tmp_path / "mine")
    scenario = scenario_on(read_feeder(tmp_path / "mine"))
    raised = scenario.replace(source_voltage_pu=1.02)
    bundled = scenario_on(load_feeder("ieee33")).replace(source_voltage_pu=1.05)
    held = scenario_on(load_feeder("ieee13-3ph"))
    said = {
        source_origin(scenario): "from mine/feeder.toml",
        source_origin(raised, 1.02): "set by --set; mine/feeder.toml has 1 p.u.",
        source_origin(raised, None, "s.toml"): "from scenario s.toml; mine/feeder.toml has 1 p.u.",
        source_origin(raised, CENTRED): "centred as --set asks; mine/feeder.toml has 1 p.u.",
        source_origin(bundled): "centred, because the bundled feeder ieee33 leaves 0.95 to 1.05 p.u. by itself at its "
        "1 p.u.",
        source_origin(
            held, CENTRED
        ): "from the bundled feeder ieee13-3ph, not centred as --set asks, because regulators act",
        source_origin(
            held.replace(source_voltage_pu=1.02), CENTRED, "s.toml"
        ): "from scenario s.toml; the bundled feeder ieee13-3ph has 1.0001 p.u., not centred as --set asks, because "
        "regulators act",
        source_origin(make_scenario("zero-shot"), None, "zero-shot"): "from scenario zero-shot",
    }
    for found, expected in said.items():
        assert found == expected
    assert source_line(raised, "set by --set") == "source at 1.02 p.u., set by --set"
