"""Laws with constant set points: which set points are open, what agents receive, and what a law refuses."""

import numpy as np
import pytest

from dcgrid_env import DcgridVectorEnv, make_scenario
from dcgrid_env.baselines import ConstantSetPoints, TwoTimescale, rollout
from dcgrid_env.baselines.laws.constant_set_points import open_set_points
from dcgrid_env.baselines.tuning.candidate_costs import mean_costs
from dcgrid_env.baselines.tuning.search import mean_cost
from dcgrid_env.baselines.tuning.tunable import TUNABLE
from helpers.three_phase import ieee13, ieee123

CHOSEN = {"offset_v": {"reg1": -2.0}, "half_band_v": {"reg1": 1.5}, "centre_pu": {"cap2": 0.99}}


def slow_and_switched(**overrides):
    return ieee13().replace(grid_control={"regulators": "setpoint", "capacitors": {"cap2": "setpoint"}}, **overrides)


def controlled(on=None, **settings):
    return ieee13().replace(**{"grid_control.regulator_settings": settings}, **on or {})


def test_open_set_points_are_those_of_agents_and_the_offsets_of_controlled_regulators():
    of_agents = {(point.parameter, point.name, point.default) for point in open_set_points(slow_and_switched())}
    assert of_agents == {("offset_v", "reg1", 0.0), ("half_band_v", "reg1", 1.0), ("centre_pu", "cap2", 1.01)}
    of_scenario = open_set_points(controlled(offset_v={"reg2": -1.5}))
    assert [(p.name, p.default, p.by_agent) for p in of_scenario] == [
        ("reg1", 0.0, False), ("reg2", -1.5, False), ("reg3", 0.0, False)
    ]  # fmt: skip
    modes = {"reg1a": "setpoint", "reg2": "agent", "reg3": "fixed"}
    mixed = ieee123().replace(**{"grid_control.regulators": modes})
    names = [(p.name, p.by_agent) for p in open_set_points(mixed) if p.parameter == "offset_v"]
    assert names == [("reg1a", True), ("creg4a", False), ("creg4b", False), ("creg4c", False)]
    scheduled = controlled(offset_v={"reg1": [(6.0, 0.0), (18.0, 1.5)]}, on={"background.start_hour": 6.0})
    assert open_set_points(scheduled) == []
    assert open_set_points(make_scenario("toy6")) == []


@pytest.mark.parametrize("law", [ConstantSetPoints, TwoTimescale])
def test_agents_receive_the_set_points_and_the_rest_keeps_the_default(law):
    scenario = slow_and_switched()
    env = DcgridVectorEnv(2, scenario)
    observations, _ = env.reset(seed=[0, 1])
    controller = law(**CHOSEN)
    controller.reset(scenario)
    env.step(controller.act(observations))
    of_devices = dict(zip((d.kind for d in scenario.devices), env.transition.state.devices, strict=True))
    regulators, banks = of_devices["regulator_setpoint"], of_devices["capacitor_setpoint"]
    np.testing.assert_allclose(regulators.offset_v, [[-2.0]] * 2, atol=1e-6)
    np.testing.assert_allclose(regulators.half_band_v, [[1.5]] * 2, atol=1e-6)
    np.testing.assert_allclose(banks.centre_pu, [[0.99]] * 2, atol=1e-6)
    np.testing.assert_allclose(banks.half_width_pu, [[0.03]] * 2, atol=1e-6)


def test_reactive_power_settles_on_the_slope_with_the_time_constant():
    law = TwoTimescale(q_share=0.2, slope_per_pu=5.0, response_s=4.0)
    scenario = slow_and_switched()
    env = DcgridVectorEnv(1, scenario)
    observations, _ = env.reset(seed=[0])
    law.reset(scenario)
    limit_kvar = law.scenario.q_scale_kvar
    for _ in range(8):
        local = law._local(observations[..., law._equipment._observed])
        _, q_kvar = law.control(local)
        target_kvar = (0.2 - 5.0 * (local.v_pu - 1.0)) * limit_kvar
        moved_kvar = local.q_kvar + (target_kvar - local.q_kvar) / 4.0  # steps of a second
        np.testing.assert_allclose(q_kvar, np.clip(moved_kvar, -limit_kvar, limit_kvar))
        observations, *_ = env.step(law.act(observations))


def test_without_slope_and_with_a_quick_response_reactive_power_is_constant():
    scenario = slow_and_switched()
    runs = [
        rollout(scenario, law, [0, 1]).costs()
        for law in (
            ConstantSetPoints(q_share=0.3, **CHOSEN),
            TwoTimescale(q_share=0.3, **CHOSEN, slope_per_pu=0.0, response_s=0.0),
        )
    ]
    np.testing.assert_array_equal(runs[0], runs[1])


@pytest.mark.parametrize("law", ["set-points", "static", "two-timescale"])
@pytest.mark.parametrize("scenario", [slow_and_switched(), controlled()], ids=["agents", "controlled"])
def test_a_batch_of_candidates_costs_what_each_costs_alone(law, scenario):
    tunable, rng = TUNABLE[law], np.random.default_rng(0)
    low, high = np.array(tunable.bounds([scenario])).T
    sets = [tunable.parameters(rng.uniform(low, high), [scenario]) for _ in range(3)]
    alone = [
        mean_cost(scenario.replace(**tunable.overrides(scenario, parameters)), tunable.law(**parameters), 2)
        for parameters in sets
    ]
    np.testing.assert_allclose(mean_costs(tunable, scenario, sets, range(2)), alone, rtol=1e-12)
    assert len(set(alone)) == 3


@pytest.mark.parametrize(
    ("law", "scenario", "message"),
    [
        (
            ConstantSetPoints(),
            ieee13().replace(grid_control={"regulators": "fixed"}),
            "static: scenario 'ieee13-three-phase' has no set points to choose; set .* to 'controlled' or",
        ),
        (
            ConstantSetPoints(),
            controlled(offset_v={"reg1": [(6.0, 0.0), (18.0, 1.5)]}, on={"background.start_hour": 6.0}),
            "give numbers for the schedules in grid_control.regulator_settings.offset_v",
        ),
        (TwoTimescale(offset_v={"reg9": 1.0}), slow_and_switched(), "two-timescale: offset_v has 'reg9', .* from reg1"),
        (ConstantSetPoints(half_band_v={"reg1": 1.0}), controlled(), "half_band_v has 'reg1', .* choose from none"),
        (ConstantSetPoints(offset_v={"reg1": 4.5}), slow_and_switched(), "'reg1' is 4.5; give a number from -4 to 4"),
        (
            ConstantSetPoints(offset_v={"reg2": -2.0}),
            controlled(),
            r"offset_v of 'reg2' is -2.0, but .* has 0 V; add --set 'grid_control.regulator_settings="
            r"""{"offset_v": {"reg1": 0.0, "reg2": -2.0, "reg3": 0.0}}'""",
        ),
    ],
)  # fmt: skip
def test_a_set_point_that_is_not_open_is_refused(law, scenario, message):
    with pytest.raises(ValueError, match=message):
        law.reset(scenario)


def test_invalid_parameters_are_refused():
    with pytest.raises(ValueError, match=r"two-timescale: response_s is -1\.0; give a finite number >= 0"):
        TwoTimescale(response_s=-1.0)
    with pytest.raises(ValueError, match=r"static: q_share is 2\.0; give shares from -1 to 1"):
        ConstantSetPoints(q_share=2.0)
