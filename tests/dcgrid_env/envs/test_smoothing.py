"""Episodes in which sites smooth their power: the same in every interface, nothing is lost, and nothing is free."""

import math
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env import (
    DcgridEnv,
    DcgridVectorEnv,
    PowerSmoothing,
    PrefillDecodeDvfs,
    Recorder,
    ScenarioError,
    TensorEnv,
    action_layout,
    field_names,
    make_scenario,
    parallel_env,
    scenario_hash,
)
from dcgrid_env.baselines import make_controller, rollout
from dcgrid_env.baselines.model_based.hindsight import hindsight
from dcgrid_env.engine.simulation import Simulation

AGENT = {"control": "agent", "hysteresis_s": 1.0, "change_every_s": 2.0, "ramp_up_w_per_s": 6000.0}


def smoothed(smoothing=None, **changes):
    """The preset ``training`` with power smoothing."""
    return make_scenario("training", **({"horizon": 60, "datacenters.smoothing": smoothing or {}} | changes))


def episode(scenario, rng=None, action=None):
    """An episode at the top clock, or at random actions, or at one action by channel."""
    layout, simulation = action_layout(scenario), Simulation(scenario, 1)
    recorder = Recorder(scenario, simulation.reset([5]))
    given_action = np.array([(action or {}).get(channel, 1.0) for _, channel in layout.names])
    for _ in range(scenario.horizon):
        recorder.add(simulation.step(given_action[None] if rng is None else rng.uniform(-1.0, 1.0, (1, layout.n))))
    return recorder.series(0)


@settings(max_examples=15, deadline=None)
@given(
    st.integers(0, 2**32),
    st.sampled_from([0.0, 0.4, 0.9]),
    st.floats(50.0, 20_000.0),
    st.floats(50.0, 20_000.0),
    st.floats(0.0, 5.0),
    st.sampled_from(["fixed", "agent"]),
    st.booleans(),
)
@pytest.mark.slow
def test_work_and_energy_are_conserved(seed, floor, up, down, hysteresis_s, control, two_classes):
    rule = {"floor_share": floor, "ramp_up_w_per_s": up, "ramp_down_w_per_s": down, "hysteresis_s": hysteresis_s}
    law = {"datacenters.clock_law": PrefillDecodeDvfs()} if two_classes else {}
    s = smoothed(rule | {"control": control}, horizon=40, **{"datacenters.boost_share": 1.2}, **law)
    series = episode(s, np.random.default_rng(seed))
    sites, own = series.devices[0], series.devices[0].features[0]
    arrived = sites.arrived_kw[1:].cumsum(axis=0) * s.dt_s
    served = sites.served_kw[1:].cumsum(axis=0) * s.dt_s
    np.testing.assert_allclose(sites.backlog_kws[1:] - sites.backlog_kws[0], arrived - served, atol=1e-6)
    assert (own.burnt_kw >= 0.0).all()
    assert (sites.served_kw >= -1e-9).all()
    drawn = series.p_kw[:, :3]
    np.testing.assert_array_equal(drawn, own.smoothed_kw[1:])
    if not two_classes:  # where power is the work served, what is burnt is the rest of the draw
        idle = np.minimum(138.0, own.smoothed_kw[1:] - own.burnt_kw[1:] - sites.served_kw[1:])
        np.testing.assert_allclose(own.burnt_kw[1:], drawn - sites.served_kw[1:] - idle, atol=1e-6)
        assert (idle <= 138.0 + 1e-6).all()
    rise = np.diff(own.smoothed_kw, axis=0)
    most_up, most_down = (own_rate[1:] * s.dt_s for own_rate in (own.ramp_up_kw_per_s, own.ramp_down_kw_per_s))
    # The idle draw alone rises faster than a ramp may.
    assert ((rise <= most_up + 1e-9) | (own.smoothed_kw[1:] <= 138.0 + 1e-9)).all()
    assert (rise >= -most_down - 1e-9).all()
    figures = series.metrics()
    assert figures["burnt_kwh"] == pytest.approx(own.burnt_kw[1:].sum() * s.dt_s / 3600.0)
    assert figures["cost_burnt"] == pytest.approx(own.burnt_kw[1:].sum() / 1800.0 / s.horizon)


def test_the_floor_outlasts_the_work_by_the_hysteresis_and_then_ramps_down():
    rule = {"floor_share": 0.8, "ramp_up_w_per_s": 1e6, "ramp_down_w_per_s": 600.0, "hysteresis_s": 2.0}
    s = make_scenario(
        "toy6", horizon=30, datacenters={"smoothing": rule, "idle_share": 0.2}, workload={"window": "start"}
    )
    # A site of 2500 kW whose work takes all of it, until its clock falls to a sixth.
    simulation = Simulation(s.replace(horizon=40), 1)
    simulation.reset([0])
    low = np.full(action_layout(s).n, 0.0)
    low[0] = 1.0
    draws, burnt, quiet = [], [], []
    for t in range(40):
        low[0] = 1.0 if t < 25 else -1.0
        own = simulation.step(low[None]).state.devices[0].features[0]
        draws.append(float(own.smoothed_kw[0, 0]))
        burnt.append(float(own.burnt_kw[0, 0]))
        quiet.append(float(own.quiet_s[0, 0]))
    # Full since t = 20; from t = 25 on two seconds at the floor, and then 0.5 of the rating a second.
    assert draws[22:25] == [2500.0] * 3
    np.testing.assert_allclose(draws[25:30], [2000.0, 2000.0, 797.87, 797.87, 797.87], atol=500.0)
    assert draws[25] == pytest.approx(2000.0)
    assert draws[26] == pytest.approx(2000.0)
    assert draws[27] < 2000.0
    assert burnt[25] > 1000.0
    assert burnt[24] == 0.0
    assert quiet[24:28] == [0.0, 1.0, 2.0, 2.0]


def test_what_a_slow_rise_keeps_from_being_served_waits():
    slow = episode(smoothed({"floor_share": 0.0, "ramp_up_w_per_s": 60.0, "hysteresis_s": 0.0}))
    free = episode(smoothed({"floor_share": 0.0, "ramp_up_w_per_s": 1e9, "ramp_down_w_per_s": 1e9}))
    plain = episode(make_scenario("training", horizon=60))
    assert slow.metrics()["held_back_kws"] > 0.0
    assert slow.metrics()["delay_mean_s"] > free.metrics()["delay_mean_s"] == 0.0
    np.testing.assert_array_equal(free.p_kw, plain.p_kw)  # a profile that limits nothing changes nothing
    np.testing.assert_array_equal(free.v_pu, plain.v_pu)


def test_channels_are_slow_and_held_between():
    s = smoothed(AGENT)
    layout, simulation = action_layout(s), Simulation(s, 1)
    assert [channel for agent, channel in layout.names if agent == "dc_0"][2:] == ["floor", "ramp_up", "ramp_down"]
    simulation.reset([0])
    floors, waits = [], []
    for t in range(45):
        state = simulation.step(np.full((1, layout.n), math.sin(t))).state
        own = state.devices[0].features[0]
        floors.append(own.floor_kw[0, 0] / 600.0)
        waits.append(own.unchanged_s[0, 0])
        assert 0.01 * 3000.0 - 1e-6 <= own.ramp_up_kw_per_s[0, 0] <= 3000.0 + 1e-6
    for t in range(45):
        assert floors[t] == pytest.approx(0.45 * (1.0 + math.sin(t - t % 20)))
    assert waits[0] == pytest.approx(1.9)
    assert waits[18] == pytest.approx(0.1)


@pytest.mark.parametrize("smoothing", [{}, AGENT], ids=["fixed", "agent"])
def test_single_batch_and_tensors_agree_and_gradients_flow(smoothing):
    s = smoothed(smoothing, datacenters={"cooling": {"time_constant_s": 3.0}})
    rng = np.random.default_rng(1)
    actions = rng.uniform(-1.0, 1.0, (s.horizon, action_layout(s).n)).astype(np.float32)
    one, batch, many = DcgridEnv(s), DcgridVectorEnv(2, s), parallel_env(s)
    tensors = TensorEnv(s, like=torch.empty(0, dtype=torch.float64))
    one.reset(seed=7)
    batch.reset(seed=[6, 7])
    many.reset(seed=7)
    tensors.reset([7])
    info = {}
    kept = torch.tensor(actions, dtype=torch.float64, requires_grad=True)
    total = torch.zeros((), dtype=torch.float64)
    slices = action_layout(s).slices
    for t, action in enumerate(actions):
        observed, reward, *_, info = one.step(action)
        wide, rewards, *_ = batch.step(np.stack((action, action)))
        apart = many.step({agent: action[at] for agent, at in slices.items()})[0]
        step = tensors.step(kept[t][None])
        total = total + step.cost_j.sum()
        assert reward == rewards[1]
        if t + 1 < s.horizon:  # where the batch has begun anew
            np.testing.assert_array_equal(observed, wide[1])
        np.testing.assert_array_equal(observed, np.concatenate(list(apart.values())))
        assert -step.cost_j.item() == pytest.approx(reward, rel=1e-5)
        np.testing.assert_allclose(step.observation[0].detach().numpy(), observed, atol=1e-5)
        assert one.observation_space.contains(observed)
    assert {"burnt_kw", "held_back_kw", "cooling_kw", "cost_burnt"} <= set(info)
    total.backward()
    gradient: Any = kept.grad
    assert torch.isfinite(gradient).all()
    if smoothing:
        for channel in ("floor", "ramp_up", "ramp_down"):
            at = action_layout(s).is_channel(channel)
            assert gradient[:, at].abs().max() > 0.0, channel
            assert (gradient[1:20, at] == 0.0).all(), channel  # held: what is set there has no effect


def test_observed_are_draw_floor_and_timer():
    names = field_names(smoothed())["dc_0"]
    assert names[-3:] == ("smoothed", "floor_held", "quiet")
    agent = field_names(smoothed(AGENT))["dc_0"]
    assert agent[-7:] == (*names[-3:], "floor_set", "ramp_up_set", "ramp_down_set", "settings_held")


def test_ramps_follow_from_the_gpus():
    by_power = PowerSmoothing(ramp_up_w_per_s=100.0, ramp_down_w_per_s=200.0, gpu_rated_w=600.0)
    by_number = PowerSmoothing(ramp_up_w_per_s=100.0, ramp_down_w_per_s=200.0, gpus=1000)
    for settings_ in (by_power, by_number):
        up, down = settings_.ramps_kw_per_s(np.array([600.0]))
        assert (up, down) == (pytest.approx([100.0]), pytest.approx([200.0]))
    up, _ = PowerSmoothing(ramp_up_w_per_s=1200.0).ramps_kw_per_s(np.array([600.0]))
    assert up == pytest.approx([600.0])  # 1200 W each: a second from nothing to the rating


def test_a_file_gives_the_same_scenario_and_at_its_default_nothing_changes(tmp_path):
    plain = make_scenario("training")
    s = smoothed(
        {"floor_share": 0.7, "gpus": (400, 500, 600)}, name="mine", datacenters={"cooling": {"cooling_share": 0.3}}
    )
    s.to_toml(tmp_path / "a.toml")
    again = make_scenario(tmp_path / "a.toml")
    assert again.difference(s) is None
    assert scenario_hash(again) == scenario_hash(s)
    assert scenario_hash(s.replace(datacenters={"smoothing": None, "cooling": None}, name="training", horizon=200)) == (
        scenario_hash(plain)
    )
    assert (
        len(
            {
                scenario_hash(x)
                for x in (s, s.replace(datacenters={"smoothing": None}), s.replace(datacenters={"cooling": None}))
            }
        )
        == 3
    )


def test_planners_refuse_by_the_name_of_the_field_and_laws_go_on():
    for changes, field in (({}, "smoothing"), ({"datacenters.smoothing": None, "datacenters.cooling": {}}, "cooling")):
        s = smoothed(horizon=3, **changes) if changes else smoothed(horizon=3)
        with pytest.raises(ValueError, match=f"hindsight plans draws .* leave datacenter_{field} out"):
            hindsight(s, 0)
        for name in ("mpc", "feedback"):
            with pytest.raises(ValueError, match=f"plans draws .* leave datacenter_{field} out"):
                rollout(s, make_controller(name), [0])
        assert np.isfinite(rollout(s, make_controller("droop"), [0]).costs()).all()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"floor_share": 1.1}, "smoothing.floor_share is 1.1; give a finite number in"),
        ({"floor_share": 0.2}, "smoothing.floor_share is 0.2; give more than the idle_share of the sites, 0.23"),
        ({"ramp_up_w_per_s": 0.0}, "smoothing.ramp_up_w_per_s is 0.0; give a finite number"),
        ({"ramp_down_w_per_s": -1.0}, "smoothing.ramp_down_w_per_s is -1.0; give a finite number"),
        ({"hysteresis_s": -0.1}, "smoothing.hysteresis_s is -0.1; give a finite number"),
        ({"gpus": 0}, "smoothing.gpus is 0; give one finite number"),
        ({"gpus": (1, 2)}, "or one for each of the 3 devices"),
        ({"gpus": 9, "gpu_rated_w": 700.0}, "smoothing.gpus is 9; give either gpus or gpu_rated_w"),
        ({"gpu_rated_w": 0.0}, "smoothing.gpu_rated_w is 0.0; give a number"),
        ({"control": "auto"}, "smoothing.control is 'auto'; choose one of fixed, agent"),
        ({"slowest_share": 0.0}, "smoothing.slowest_share is 0.0; give a finite number"),
        ({"change_every_s": -1.0}, "smoothing.change_every_s is -1.0"),
        ({"floor": 0.5}, "datacenters.smoothing.floor is no field; did you mean floor_share"),
        (0.9, r"datacenters.smoothing is 0.9; give PowerSmoothing\(...\) or a mapping of its fields, or None"),
    ],
)
def test_bad_settings_are_refused_by_field_value_and_remedy(wrong, message):
    with pytest.raises(ScenarioError, match=message):
        smoothed(wrong)
