"""Features of data centres combined with each other and with faults: shared effects are charged once and are real."""

import numpy as np
import pytest

import dcgrid_env
from dcgrid_env import Batching, DcgridVectorEnv, Fault, Sag, TensorEnv, UpsRideThrough, make_scenario
from dcgrid_env.agents.policy.interface import PolicyInterface
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.baselines.model_based.hindsight import hindsight

AT_ONCE = UpsRideThrough(
    curve="itic", battery_s=30.0, recharge_share=1.0, walk_in_s=0.0, lockout_events=0, returns_per_minute=0
)


def states(s, change=None, seed=3):
    """Return states and charges after each step with all channels inactive except those that ``change`` names."""
    env = DcgridVectorEnv(1, s)
    observations, _ = env.reset(seed=[seed])
    layout = dcgrid_env.action_layout(s)
    action = NoControl()
    action.reset(s)
    joint = np.array(action.act(observations), np.float32)
    for name, value in (change or {}).items():
        joint[:, layout.is_channel(name)] = value
    found = []
    for _ in range(s.horizon):
        env.step(joint)
        found.append((env.transition.state, env.transition.costs))
    return found


@pytest.mark.parametrize("cooling", [{}, {"cooling_share": 1.5}])
def test_cooling_changes_nothing_of_the_work(cooling):
    plain = make_scenario("toy6", horizon=40, datacenters={"boost_share": 2.0})
    cooled = plain.replace(datacenters={"cooling": cooling})
    one, other = (dcgrid_env.forecast(s, 0).p_ref_kw for s in (plain, cooled))
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    "overrides",
    [
        {
            "n_datacenters": 0,
            "datacenters.buses": None,
            "datacenters.p_rated_kw": 500.0,
            "datacenters.ride_through": "itic",
        },
        {"inverters.buses": (), "inverters.s_rated_kva": 100.0, "inverters.ride_through": "itic"},
    ],
    ids=["no sites", "no inverters"],
)
def test_a_rule_of_nobody_harms_nobody(overrides):
    s = make_scenario("ieee33-weak", horizon=3, **overrides)
    assert rollout(s, NoControl(), [0]).metrics()[0]["voltage_after_loss_max_pu"] == 0.0
    with pytest.raises(dcgrid_env.ScenarioError, match=r"sags is given, .* give at least one, or leave sags out"):
        s.replace(sags="virginia-2024")


def test_waiting_for_a_batch_is_charged_for_what_was_served_in_the_end():
    slow = {"floor_share": 0.0, "ramp_up_w_per_s": 5.0}
    s = make_scenario("bursty", horizon=60, datacenters={"smoothing": slow, "batching": Batching()})
    for state, costs in states(s, {"batch": 1.0}):
        served = state.served_kw.sum()
        assert costs.gathering[0] == pytest.approx(0.3 * served * 0.1 * (512 / 64 - 1) / 3000.0)


def test_a_site_that_a_fault_has_taken_neither_recharges_nor_is_lost_again():
    sag = (Sag(begin_s=(36.0, 36.0), duration_s=(0.06, 0.06), retained_pu=(0.3, 0.3)),)
    s = make_scenario("ieee33-weak", horizon=60, datacenters={"ride_through": AT_ONCE}, sags=sag)
    lost = s.replace(faults=(Fault(("dc_0",), begin_s=(40.0, 40.0)),))
    stored = np.array([state.devices[0].battery.stored_kws[0] for state, _ in states(lost)])
    after = stored[41:, 0]
    assert after[0] < AT_ONCE.battery_s * 1000.0
    assert (np.diff(after) <= 0.0).all()
    early = s.replace(faults=(Fault(("dc_0",), begin_s=(4.0, 4.0)),))
    trips = np.sum([state.devices[0].ups.tripped[0] for state, _ in states(early)], axis=0)
    assert trips[0] == 0.0
    assert trips[1:].sum() == 2.0


def test_nothing_is_burnt_or_cooled_in_the_dark():
    sag = (Sag(begin_s=(20.0, 20.0), duration_s=(0.06, 0.06), retained_pu=(0.3, 0.3)),)
    rule = UpsRideThrough(curve="itic", battery_s=0.0)
    smoothing = {"floor_share": 0.9, "hysteresis_s": 100.0}
    s = make_scenario(
        "bursty",
        horizon=22,
        datacenters={"ride_through": rule, "smoothing": smoothing, "cooling": {}},
        sags=sag,
    )
    last = states(s)[-1][0].devices[0]
    assert (last.ups.share == 0.0).all()
    for own in (last.burnt_kw, last.computing_kw, last.cooling_kw, last.auxiliary_kw):
        np.testing.assert_array_equal(own, 0.0)


def test_a_ups_carries_the_cooling_too_where_work_waits():
    sag = (Sag(begin_s=(20.0, 20.0), duration_s=(0.06, 0.06), retained_pu=(0.3, 0.3)),)
    rule = UpsRideThrough(curve="itic", on_battery="waits")
    s = make_scenario("ieee33-weak", horizon=22, datacenters={"ride_through": rule, "cooling": {}}, sags=sag)
    away = states(s)[-1][0].devices[0]
    assert (away.ups.share == 0.0).all()
    np.testing.assert_allclose(away.battery.battery_kw, 230.0 * 1.2 + 50.0)


def test_the_largest_cost_of_a_step_bounds_ramps_of_storage_and_waits_of_batches():
    s = make_scenario(
        "ieee33-weak",
        horizon=6,
        cost={"ramp_limit_kw_per_s": 100.0, "ramp_window_s": 1.0},
        datacenters={"storage": {"p_rated_kw": 2000.0, "energy_kwh": 50.0}},
        weights={"ramp_excess": 1.0},
    )
    from dcgrid_env.scenario.costs.utility_limits import largest_ramp_excess

    env = DcgridVectorEnv(1, s)
    env.reset(seed=[0])
    at, seen = dcgrid_env.action_layout(s).is_channel("storage_p"), 0.0
    for step in range(6):
        action = np.ones((1, len(at)), np.float32)
        action[:, at] = 1.0 if step % 2 else -1.0
        env.step(action)
        seen = max(seen, getattr(env.transition.costs, "ramp_excess")[0])  # noqa: B009
    assert 9.0 < seen <= largest_ramp_excess(s)
    boosted = make_scenario(
        "toy6", datacenters={"idle_share": 0.0, "boost_share": 2.0, "batching": Batching(batch_weight=1.0)}
    )
    term = {term.name: term for term in boosted.datacenters.cost_terms(100, 1.0)}["gathering"]
    assert term.largest > 1.4


def test_a_policy_without_preview_sees_nothing_of_what_comes():
    s = make_scenario("routing", horizon=3)
    seen = PolicyInterface(s, "joint", preview=False).inputs(np.ones(sum(map(len, dcgrid_env.field_names(s).values()))))
    names = [name for own in dcgrid_env.field_names(s).values() for name in own]
    hidden = {name for name, value in zip(names, seen["joint"], strict=True) if value == 0.0}
    assert hidden == {"p_ref_next", "work_next_all"}


def test_hindsight_takes_a_deadline_beyond_the_episode():
    s = make_scenario("toy6", horizon=20, datacenters={"service": {}})
    found = hindsight(s, 0)
    assert found.bound <= found.J + 1e-6


@pytest.mark.slow
def test_what_all_sites_are_asked_is_within_its_range():
    s = make_scenario(
        "toy6", horizon=30, datacenters={"idle_share": 0.8, "boost_share": 2.0, "routing": {}}, trace="code"
    )
    env = TensorEnv(s, like=np.empty(0))
    observation = env.reset([3])
    names = [name for own in dcgrid_env.field_names(s).values() for name in own]
    field = next(f for f in s.datacenters.fields(30, 1.0) if f.name == "work_next_all")
    assert field.highest == pytest.approx(6.0)
    assert (np.asarray(observation)[..., names.index("work_next_all")] <= 6.0).all()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"datacenters.storage": {"p_rated_kw": -1, "energy_kwh": 1}}, "storage.p_rated_kw is -1"),
        ({"datacenters.ride_through": {"curve": "itic", "walk_in_s": -1}}, "ride_through.walk_in_s is -1"),
        ({"datacenters.ride_through": {"curve": ["itic", "itic"]}}, "ride_through.curve has 2 curves"),
        ({"datacenters.smoothing": {"gpus": 10**400}}, "smoothing.gpus is 1000"),
    ],
)
def test_an_error_names_the_field_that_holds_the_settings(given, message):
    with pytest.raises(dcgrid_env.ScenarioError, match=message):
        make_scenario("ieee33-weak", **given)
