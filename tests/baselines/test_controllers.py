"""The controllers: their laws by hand, and one object for one environment or a batch."""

import numpy as np
import pytest

from dcgrid_env import DcgridEnv, DcgridVectorEnv, PrefillDecodeDvfs, make_scenario, parallel_env
from dcgrid_env.baselines import (
    CONTROLLERS,
    Controller,
    Droop,
    Local,
    LocalController,
    NeedsPlacement,
    make_controller,
    rollout,
)
from helpers.needs import NEEDING_A_DEVICE


def seen(scenario, v_pu, q_kvar=0.0, p_kw=None, p_ref_kw=None, backlog_kws=0.0):
    """A local observation of toy6's three agents in physical units."""
    n_dc, n = scenario.datacenters.count, scenario.n_agents
    return Local(
        v_pu=np.full(n, v_pu),
        p_kw=np.zeros(n) if p_kw is None else np.array(p_kw),
        q_kvar=np.full(n, q_kvar),
        p_ref_next_kw=np.full(n_dc, 575.0) if p_ref_kw is None else np.array(p_ref_kw),
        backlog_kws=np.full(n_dc, backlog_kws),
        r_pu_per_mw=np.full(n, 0.01),
        x_pu_per_mvar=np.full(n, 0.02),
        stored_kwh=np.zeros(0),
    )


def started(controller, **overrides):
    scenario = make_scenario("toy6", **overrides)
    controller.reset(scenario)
    return scenario


def clock_of(p_kw):
    """toy6: 2.5 MW rated, idle 575 kW, top clock 1410 MHz."""
    return (p_kw - 575.0) / 1925.0 * 1410.0


def test_droop_by_hand():
    droop = Droop(k_p_mw_per_pu=10.0, k_q_mvar_per_pu_s=0.5, alpha_per_s=0.3)
    scenario = started(droop)
    # P = 2000 + 10,000 (0.97 - 1) + 0.3 * 400 = 1820 kW;  Q = 50 - 500 * (-0.03) * 1 = 65 kvar
    f, q = droop.control(seen(scenario, 0.97, q_kvar=50.0, p_ref_kw=[2000.0], backlog_kws=400.0))
    assert f == pytest.approx([clock_of(1820.0)])
    assert q == pytest.approx([65.0, 65.0, 65.0])


def test_droop_limits():
    droop = Droop(k_p_mw_per_pu=20.0)
    scenario = started(droop)
    f, q = droop.control(seen(scenario, 0.80, q_kvar=990.0, p_ref_kw=[600.0]))
    assert f == pytest.approx([210.0])
    assert q == pytest.approx([825.0, 1000.0, 1000.0])  # 0.33 of 2500 kW; 1 Mvar each
    f, _ = droop.control(seen(scenario, 1.10, p_ref_kw=[2500.0]))
    assert f == pytest.approx([1410.0])


def test_droop_integrates_over_dt():
    droop = Droop(k_q_mvar_per_pu_s=0.5)
    scenario = started(droop, dt_s=0.2)
    _, q = droop.control(seen(scenario, 0.98, q_kvar=10.0))
    assert q == pytest.approx([12.0] * 3)


def test_one_step_memory_is_the_last_shortfall_alone():
    droop = Droop(k_p_mw_per_pu=0.0, alpha_per_s=0.5, memory="one_step")
    scenario = started(droop)
    first = seen(scenario, 1.0, p_ref_kw=[2000.0], backlog_kws=999.0)
    f, _ = droop.control(first)
    assert f == pytest.approx([clock_of(2000.0)])  # nothing remembered yet, and the backlog is not looked at
    f, _ = droop.control(seen(scenario, 1.0, p_kw=[1600.0, 0.0, 0.0], p_ref_kw=[1000.0], backlog_kws=999.0))
    assert f == pytest.approx([clock_of(1000.0 + 0.5 * (2000.0 - 1600.0))])
    f, _ = droop.control(seen(scenario, 1.0, p_kw=[1200.0, 0.0, 0.0], p_ref_kw=[1000.0]))
    assert f == pytest.approx([clock_of(1000.0 + 0.5 * (1000.0 - 1200.0))])  # negative: it had served more
    droop.reset(scenario)
    f, _ = droop.control(first)
    assert f == pytest.approx([clock_of(2000.0)])


def test_inverters_only_leaves_the_data_centres_alone():
    controller = make_controller("inverters")
    assert isinstance(controller, Droop)
    scenario = started(controller)
    f, q = controller.control(seen(scenario, 0.96, q_kvar=0.0))
    assert f == pytest.approx([1410.0])
    assert q == pytest.approx([0.0, 20.0, 20.0])


LOCAL = [
    name
    for name, (_, make) in CONTROLLERS.items()
    if name not in NEEDING_A_DEVICE and not isinstance(make(), NeedsPlacement)
]


@pytest.mark.parametrize(
    "law",
    [{}, {"datacenters.clock_law": PrefillDecodeDvfs(), "datacenters.boost_share": 1.3}],
    ids=["linear", "work_classes"],
)
@pytest.mark.parametrize("name", LOCAL)
def test_one_object_drives_every_interface(name, law):
    """Joined, per agent and batched observations lead to the same trajectory of the same episode."""
    scenario = make_scenario("ieee123", horizon=15, **law)
    controller = make_controller(name)
    assert isinstance(controller, Controller)
    recorder = rollout(scenario, controller, [21, 22, 23])
    assert recorder.over

    single = DcgridEnv(scenario)
    observation, _ = single.reset(seed=22)
    controller.reset(scenario)
    joined = [single.step(action := controller.act(observation))]
    assert action.shape == single.action_space.shape
    while not joined[-1][3]:
        joined.append(single.step(controller.act(joined[-1][0])))

    many = parallel_env(scenario)
    observations, _ = many.reset(seed=22)
    controller.reset(scenario)
    apart = []
    while many.agents:
        actions = controller.act(observations)
        assert all(many.action_space(a).contains(actions[a]) for a in many.agents)
        observations, rewards, *_ = many.step(actions)
        apart.append(rewards["dc_0"])

    assert [step[1] for step in joined] == apart == (-recorder.series(1).cost_j).tolist()


@pytest.mark.parametrize("scope", ["neighbours", "feeder"])
def test_controllers_read_wider_observations_too(scope):
    narrow = rollout(make_scenario("ieee33-weak", horizon=10), Droop(), [0]).metrics()
    wide = rollout(make_scenario("ieee33-weak", horizon=10, observe=scope), Droop(), [0]).metrics()
    assert narrow == wide


def test_inverters_alone_need_no_data_centre():
    scenario = make_scenario("ieee123", n_datacenters=0, horizon=5)
    metrics = rollout(scenario, make_controller("inverters"), [0])
    assert metrics.metrics()[0]["arrived_kws"] == 0.0


def test_droop_does_better_than_nothing_and_conserves_work():
    scenario = make_scenario("ieee33-weak", split="validation")
    runs = {
        name: rollout(scenario, make_controller(name), range(4)).metrics() for name in ("none", "inverters", "droop")
    }
    j = {name: np.mean([m["J"] for m in metrics]) for name, metrics in runs.items()}
    assert j["droop"] < j["inverters"] < j["none"]
    assert all(m["delay_mean_s"] == m["unserved_kws"] == 0.0 for m in runs["none"])
    assert all(m["delay_mean_s"] > 0.0 for m in runs["droop"])
    assert [m["arrived_kws"] for m in runs["none"]] == [m["arrived_kws"] for m in runs["droop"]]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"k_p_mw_per_pu": -1.0}, "k_p_mw_per_pu is -1.0"),
        ({"alpha_per_s": float("nan")}, "alpha_per_s is nan"),
        ({"memory": "none"}, "choose one of cumulative, one_step"),
    ],
)
def test_bad_gains(arguments, message):
    with pytest.raises(ValueError, match=message):
        Droop(**arguments)


def test_without_preview_the_droop_caps_at_the_rating():
    droop = Droop(k_p_mw_per_pu=10.0, alpha_per_s=0.3)
    scenario = started(droop, sensing={"preview": False})
    # P = 2500 + 10,000 (0.97 - 1) + 0.3 * 400 = 2320 kW, whatever is coming
    f, _ = droop.control(seen(scenario, 0.97, p_ref_kw=[0.0], backlog_kws=400.0))
    assert f == pytest.approx([clock_of(2320.0)])
    with pytest.raises(ValueError, match=r"one-step memory needs p_ref; make the scenario with sensing\.preview"):
        Droop(memory="one_step").reset(make_scenario("ieee123", sensing={"preview": False}))
    make_controller("inverters").reset(make_scenario("ieee123", sensing={"preview": False}))


def test_unknown_name_lists_what_exists():
    with pytest.raises(ValueError, match="no controller 'pid'; `dcgrid list controllers`"):
        make_controller("pid")


class Broken(LocalController):
    def control(self, local):
        return np.full_like(local.p_ref_next_kw, np.nan), np.zeros_like(local.v_pu)


def test_a_controller_that_returns_nan_is_named_by_agent():
    with pytest.raises(ValueError, match=r"action of dc_0: clock is nan in environment 0"):
        rollout(make_scenario("toy6"), Broken(), [0, 1])


def test_rollout_counts_each_environment_once():
    scenario = make_scenario("toy6", horizon=5)
    steps = []
    recorder = rollout(scenario, make_controller("none"), [4, 5], lambda: steps.append(1))
    assert len(steps) == 5
    assert [m["steps"] for m in recorder.metrics()] == [5.0, 5.0]
    env = DcgridVectorEnv(2, scenario)
    env.reset(seed=[4, 5])
    assert recorder.series(1).v_pu[0] == pytest.approx(env.transition.state.v_pu[1])
