"""Episodes in which sites and inverters leave the grid and return: the same in every interface, and nothing is lost."""

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from dcgrid_env import (
    DcgridEnv,
    Recorder,
    ScenarioError,
    TensorEnv,
    action_layout,
    make_scenario,
    parallel_env,
    scenario_hash,
)
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.devices.ride_through.sags import Sag, virginia_2024
from dcgrid_env.engine.exogenous.drawn_events import drawn_sags
from dcgrid_env.engine.simulation import Simulation
from helpers.riding import at_top_clock, riding


def episode(scenario, seeds=(3,), action=None):
    """Recorder and simulation of an episode in each environment."""
    simulation = Simulation(scenario, len(seeds))
    recorder = Recorder(scenario, simulation.reset(list(seeds)))
    action = at_top_clock(scenario) if action is None else action
    for _ in range(scenario.horizon):
        recorder.add(simulation.step(np.tile(action, (len(seeds), 1))))
    return recorder, simulation


@pytest.mark.parametrize("name", ["ieee33-weak", "ieee34-3ph"])
def test_the_recorded_sags_lock_out_at_the_third_and_all_return(name):
    figures = episode(riding(name))[0].metrics()[0]
    sites = make_scenario(name).datacenters.count
    assert figures["ups_trips"] >= sites
    assert figures["ups_locked_s"] > 0.0
    assert 0.0 < figures["ups_all_back_s"] < 150.0
    assert figures["voltage_after_loss_max_pu"] > 1.0
    assert figures["battery_work_kws"] > 0.0


def test_work_is_conserved_whether_it_goes_on_or_waits():
    for on_battery in ("serves", "waits"):
        rule = {"curve": "itic", "by_hand_s": 20.0, "battery_s": 10.0, "on_battery": on_battery}
        series = episode(riding(datacenters={"ride_through": rule}))[0].series(0)
        arrived, served = series.arrived_kw.sum(), series.served_kw.sum()
        assert arrived == pytest.approx(served + series.backlog_kws[-1].sum(), rel=1e-9)
        state = series.devices[0]
        away = state.ups.share[1:] == 0.0
        assert away.any()
        assert (series.p_kw[:, : away.shape[1]][away] == 0.0).all()
        assert (series.q_kvar[:, : away.shape[1]][away] == 0.0).all()
        dark = away & (state.battery.stored_kws[1:] == 0.0) & (state.battery.battery_kw[1:] == 0.0)
        assert (state.served_kw[1:][dark] == 0.0).all()


def test_energy_of_the_batteries_is_conserved_and_what_is_missing_is_charged():
    scenario = riding(horizon=60)
    series = episode(scenario)[0].series(0)
    battery, rule = series.devices[0].battery, scenario.datacenters.ride_through
    assert rule
    full = scenario.datacenters.parameters.p_rated_kw * rule.battery_s
    balance = full + (rule.charge_efficiency * battery.recharge_kw[1:] - battery.battery_kw[1:]).sum(0)
    assert battery.stored_kws[-1] == pytest.approx(balance, rel=1e-9)
    missing = (full - battery.stored_kws[-1]).sum()
    assert missing > 0.0
    assert series.costs["recharge"][-1] == pytest.approx(
        9.0 * missing / scenario.datacenters.parameters.p_rated_kw.sum()
    )
    assert series.costs["recharge"][:-1].sum() == 0.0


@pytest.mark.parametrize("name", ["ieee33-weak", "ieee34-3ph"])
@pytest.mark.slow
def test_single_batch_and_tensors_go_the_same_way(name):
    scenario = riding(
        name, datacenters={"ride_through": {"curve": "itic", "release": "agent", "walk_in_s": 5.0}}, horizon=110
    )
    seeds = [3, 4, 5]
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1.0, 1.0, (scenario.horizon, len(seeds), action_layout(scenario).n))
    batch, singles = Simulation(scenario, 3), [Simulation(scenario, 1) for _ in seeds]
    tensors = TensorEnv(scenario, like=torch.empty(0, dtype=torch.float64))
    batch.reset(seeds)
    tensors.reset(seeds)
    for single, seed in zip(singles, seeds, strict=True):
        single.reset([seed])
    trips = 0.0
    for joint in actions:
        together = batch.step(joint)
        step = tensors.step(torch.tensor(joint))
        trips += together.state.devices[0].ups.tripped.sum()
        for i, single in enumerate(singles):
            alone = single.step(joint[i : i + 1])
            assert np.array_equal(alone.observation[0], together.observation[i])
            assert alone.reward[0] == together.reward[i]
        for on_tensors, on_arrays in zip(step.state.devices[0].ups, together.state.devices[0].ups, strict=True):
            assert on_tensors.numpy() == pytest.approx(on_arrays, abs=1e-6)
        assert step.cost_j.numpy() == pytest.approx(together.cost_j, rel=1e-6, abs=1e-6)
    assert trips >= 6.0


def test_the_interfaces_have_it_all():
    scenario = riding(datacenters={"ride_through": {"curve": "itic", "release": "agent"}}, horizon=40)
    single = DcgridEnv(scenario)
    single.reset(seed=1)
    parallel = parallel_env(scenario)
    parallel.reset(seed=1)
    assert parallel.action_space("dc_0").shape == (3,)
    vector = gymnasium.make_vec("dcgrid/IEEE33Weak-v0", num_envs=2, scenario=scenario)
    vector.reset(seed=1)
    observation, final = np.zeros(0), np.zeros((1, 1))
    for _ in range(40):
        joint = single.action_space.sample()
        observation, _, _, _, info = single.step(joint)
        parts = action_layout(scenario).split(joint)
        parallel.step(parts)
        assert single.observation_space.contains(observation)
        assert {"ups_trips", "ups_lost_kw", "ups_away", "ups_locked", "battery_kw", "inverter_trips"} <= set(info)
        batch, _, _, _, infos = vector.step(np.stack([joint, joint]))
        final = infos.get("final_obs", batch)
    assert np.array_equal(final[0], observation)


def test_trips_that_have_a_weight_stand_in_the_cost_of_constrained_learning():
    rule = {"curve": "itic", "trip_weight": 50.0}
    env = DcgridEnv(riding(datacenters={"ride_through": rule}, weights={"violation": 0.0}, horizon=40))
    env.reset(seed=1)
    infos = [env.step(at_top_clock(env.scenario))[4] for _ in range(40)]
    assert [info["cost"] for info in infos] == [50.0 * info["ups_trips"] / 3 for info in infos]
    assert sum(info["cost"] for info in infos) > 0.0


def test_a_file_gives_the_same_scenario(tmp_path):
    scenario = riding(datacenters={"ride_through": {"curve": {"under": [[0.8, 0.5]]}, "release": "staggered"}})
    scenario.to_toml(tmp_path / "riding.toml")
    again = make_scenario(str(tmp_path / "riding.toml")).replace(name=scenario.name)
    assert again.sags == scenario.sags
    assert again.devices == scenario.devices
    assert scenario_hash(again) == scenario_hash(scenario)


def test_at_its_default_nothing_changes_and_set_it_changes_the_hash():
    plain = make_scenario("ieee33-weak")
    assert scenario_hash(plain.replace(sags=())) == scenario_hash(plain)
    assert len({scenario_hash(s) for s in (plain, riding(), riding(sags=()))}) == 3


def test_without_events_the_episode_is_that_without_a_rule():
    quiet = riding(
        sags=(), datacenters={"ride_through": {"curve": {"under": [[0.2, 1.0]]}}}, inverters={"ride_through": None}
    )
    plain = make_scenario("ieee33-weak", horizon=quiet.horizon)
    with_rule, without = (episode(scenario)[0].series(0) for scenario in (quiet, plain))
    assert np.array_equal(with_rule.v_pu, without.v_pu)
    assert np.array_equal(with_rule.cost_j, without.cost_j)


def test_slow_undervoltage_is_what_the_clock_can_prevent():
    rule = {"curve": {"under": [[0.93, 5.0]]}, "by_hand_s": 30.0}
    scenario = riding(sags=(), datacenters={"ride_through": rule}, inverters={"ride_through": None})
    low = np.where(action_layout(scenario).is_channel("clock"), -1.0, 1.0)
    at_top, throttled = (episode(scenario, (3, 4), a)[0].metrics() for a in (at_top_clock(scenario), low))
    assert sum(m["ups_trips"] for m in at_top) > sum(m["ups_trips"] for m in throttled)


def test_sags_are_drawn_within_their_ranges_and_as_a_sequence():
    scenario = riding()
    drawn = drawn_sags(scenario, np.arange(200, dtype=np.uint64))
    assert np.diff(drawn[..., 0], axis=1) == pytest.approx(82.0 / 5)
    assert (drawn[:, 0, 0].min(), drawn[:, 0, 0].max()) == pytest.approx((10.0, 30.0), abs=1.0)
    assert (drawn[..., 1].min(), drawn[..., 1].max()) == pytest.approx((0.042, 0.066), abs=1e-3)
    assert (drawn[..., 2].min(), drawn[..., 2].max()) == pytest.approx((0.25, 0.40), abs=1e-2)
    assert drawn[:, 0, 1].std() > 0.0


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"sags": "texas"}, "sags is 'texas'; choose one of virginia-2024"),
        ({"sags": [{"begin_s": [1, 2], "duration_s": [0.1, 0.1]}]}, r"sags\[0\].retained_pu is missing"),
        ({"sags": [{"begin_s": 1, "duration_s": 0, "retained_pu": 0.3}]}, r"sags\[0\].duration_s is .* above 0 s"),
        ({"sags": [{"begin_s": [2, 1], "duration_s": 0.1, "retained_pu": 0.3}]}, "give the lowest first"),
        ({"sags": [{"begin_s": 1, "duration_s": 0.1, "retained_pu": 1.3}]}, "retained_pu is 1.3; give a number"),
        ({"sags": virginia_2024()[1:]}, r"sags\[0\].since is 'previous'; none is listed before it"),
        ({"datacenters.ride_through": None, "inverters.ride_through": None}, "no device has a curve that decides"),
        ({"datacenters.ride_through": {"curve": ["itic"]}}, "curve has 1 curves; give one, or one for each of 3"),
        ({"datacenters.ride_through": {"kurve": "itic"}}, "datacenters.ride_through.kurve is no field; did you"),
        ({"inverters.ride_through": {"curve": "itic", "battery_s": 3.0}}, "battery_s is no field"),
        ({"sags": (1,)}, r"sags is \(1,\); give a list of Sag"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_by_field_value_and_remedy(changes, said):
    with pytest.raises(ScenarioError, match=said):
        riding(**changes)


def test_a_sag_of_single_numbers_is_a_range_without_width():
    figures: Any = {"begin_s": 1.0, "duration_s": 0.1, "retained_pu": 0.5}
    assert Sag(**figures).begin_s == (1.0, 1.0)


@pytest.mark.parametrize("walk_in_s", [9.0, 10.0, 20.0])
def test_a_ramp_of_whole_steps_takes_no_step_more(walk_in_s):
    """The sag takes the site off in one step; it waits for three and is back with the last step of its ramp."""
    scenario = make_scenario(
        "ieee33-weak", horizon=40, datacenters={"ride_through": {"curve": "itic", "walk_in_s": walk_in_s}},
        sags=[{"begin_s": 10.5, "duration_s": 0.05, "retained_pu": 0.3}],
    )  # fmt: skip
    assert rollout(scenario, NoControl(), [0]).metrics()[0]["ups_all_back_s"] == walk_in_s + 3.0


def test_a_rule_with_a_key_that_is_no_text_is_refused():
    with pytest.raises(ScenarioError, match=r"inverters.ride_through.1 is no field; its fields are curve"):
        make_scenario("ieee33", inverters={"ride_through": {1: 2}})
