"""The linear feeder model of controllers, and its use of old or noisy measurements."""

import numpy as np
import pytest

from dcgrid_env import (
    CostWeights,
    DcgridEnv,
    PrefillDecodeDvfs,
    distflow,
    forecast,
    lindistflow,
    make_scenario,
    sensitivity,
)
from dcgrid_env.baselines.model_based.feedback import FeedbackOptimisation
from dcgrid_env.baselines.model_based.linear_model import ModelController, slopes
from dcgrid_env.baselines.model_based.mpc import Mpc
from dcgrid_env.baselines.rollout import rollout

BOTH = [FeedbackOptimisation, lambda: Mpc(horizon=3, rounds=20)]


class Restless(ModelController):
    """Moves everything all the time and keeps what it believes of the voltages."""

    name = "restless"

    def reset(self, env_info):
        super().reset(env_info)
        self.believed, self.arrived = [], []

    def plan(self, now):
        s, k = self.scenario, len(self.believed)
        self.believed.append(now.v_pu)
        self.arrived.append(now.p_ref_kw)
        n_env = len(now.v_pu)
        swing = np.sin(0.7 * k + np.arange(s.n_agents))
        return np.full((n_env, s.datacenters.count), 700.0 + 500.0 * np.sin(k)), np.tile(
            swing * self._q_scale, (n_env, 1)
        )


def course(recorder, n_env):
    return np.stack([recorder.series(i).v_pu[:, 1:] for i in range(n_env)], axis=1)


def test_slopes_by_hand():
    """LinDistFlow's columns of the agents' buses, a draw lowering and an injection raising the voltage."""
    scenario = make_scenario("toy6")
    feeder = scenario.feeder
    known = slopes(scenario, np.array([[feeder.index(bus) for bus in (4, 3, 5)]]))
    assert known.by_p.shape == known.by_q.shape == (1, 3, feeder.n_bus - 1)
    r, x = sensitivity(feeder)
    at = feeder.index(4)
    assert known.by_p[0, 0] == pytest.approx(-r[at, 1:] / 1000.0)
    assert known.by_q[0, 0] == pytest.approx(x[at, 1:] / 1000.0)


def test_slopes_are_those_of_the_power_flow_around_one_per_unit():
    scenario = make_scenario("ieee33-weak")
    feeder = scenario.feeder
    buses = np.array([[feeder.index(bus) for bus in (18, 33, 25, *scenario.inverters.buses)]])
    known = slopes(scenario, buses)
    none = np.zeros(feeder.n_bus)
    flat = distflow(feeder, none, none, 1.0).v_pu
    for agent, bus in enumerate(buses[0]):
        kw = np.eye(feeder.n_bus)[bus]
        np.testing.assert_allclose(
            distflow(feeder, kw, none, 1.0).v_pu[1:] - flat[1:], known.by_p[0, agent], rtol=2e-3, atol=1e-12
        )
        np.testing.assert_allclose(
            distflow(feeder, none, -kw, 1.0).v_pu[1:] - flat[1:], known.by_q[0, agent], rtol=2e-3, atol=1e-12
        )


def test_the_believed_impedances_are_used():
    true, off = (
        make_scenario("ieee33-weak"),
        make_scenario("ieee33-weak", sensing={"r_model_share": 0.8, "x_model_share": 1.2}),
    )
    buses = np.array([[17, 32]])
    np.testing.assert_allclose(slopes(off, buses).by_p, 0.8 * slopes(true, buses).by_p)
    np.testing.assert_allclose(slopes(off, buses).by_q, 1.2 * slopes(true, buses).by_q)


def test_environments_of_one_placement_share_their_slopes():
    scenario = make_scenario("ieee33-weak")
    assert len(slopes(scenario, np.array([[17, 32], [17, 32]])).by_p) == 1
    assert len(slopes(scenario, np.array([[17, 32], [17, 31]])).by_p) == 2


def test_what_is_believed_is_what_is_measured():
    scenario = make_scenario("ieee33-weak", horizon=12)
    restless = Restless()
    v = course(rollout(scenario, restless, [0, 1]), 2)
    np.testing.assert_allclose(restless.believed, v[:-1], atol=1e-7)


@pytest.mark.parametrize("delay", [1, 3])
def test_an_old_measurement_is_brought_up_to_date(delay):
    """The other loads are constant, so agents cause all changes, which the model predicts except for nonlinearity."""
    scenario = make_scenario("ieee33-weak", horizon=15, background={"load_sigma": 0.0}, sensing={"delay_steps": delay})
    restless = Restless()
    v = course(rollout(scenario, restless, [0, 1]), 2)[:-1]
    moved = np.sqrt(((v[delay:] - v[:-delay]) ** 2).mean())
    assert moved > 0.004
    assert np.sqrt(((np.array(restless.believed) - v)[delay:] ** 2).mean()) < 0.15 * moved


def test_noise_is_smoothed_by_more_than_half():
    noise = 0.01
    scenario = make_scenario("ieee33-weak", horizon=60, sensing={"noise_pu": noise})
    restless = Restless()
    v = course(rollout(scenario, restless, range(4)), 4)[:-1]
    error = (np.array(restless.believed) - v)[20:]
    assert 0.0 < np.sqrt((error**2).mean()) < 0.5 * noise


@pytest.mark.parametrize("changed", [{}, {"dt_s": 0.2}, {"background.load_rho": 0.6, "background.load_sigma": 0.02}])
def test_the_gain_is_that_of_what_the_loads_do_in_a_step(changed):
    """The other loads of episodes as drawn, on the linear grid, and the steady state of Kalman's recursion."""
    noise = 0.0005
    scenario = make_scenario("ieee33-weak", horizon=400, **{"sensing.noise_pu": noise}, observe="feeder", **changed)
    moves = []
    for seed in range(12):
        known = forecast(scenario, seed)
        v_pu = lindistflow(scenario.feeder, known.p_load_kw, known.q_load_kvar, 1.0).v_pu[:, 1:]
        moves.append(np.diff(0.5 * v_pu**2, axis=0))  # what a voltage of 1 p.u. would move by
    variance, gain = 0.0, 1.0
    for _ in range(1000):  # predicted, then corrected
        predicted = variance + np.mean(np.square(moves))
        gain = predicted / (predicted + noise**2)
        variance = (1.0 - gain) * predicted
    restless = Restless()
    restless.reset(scenario)
    assert 0.1 < gain < 0.9
    assert restless._gain == pytest.approx(gain, rel=0.02)


def test_p_ref_is_reconstructed_from_draw_and_queue():
    scenario = make_scenario("ieee33-weak", horizon=30, sensing={"preview": False})
    restless = Restless()
    series = rollout(scenario, restless, [3]).series(0)
    assert series.backlog_kws.max() > 10.0
    idle_kw = scenario.datacenters.parameters.p_idle_kw
    arrived = np.maximum(np.array(restless.arrived)[1:, 0] - idle_kw, 0.0)
    np.testing.assert_allclose(arrived, series.arrived_kw[:-1], atol=1e-2)


@pytest.mark.parametrize("make", BOTH)
@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"observe": "local"}, "observe is 'local'; make the scenario with observe='feeder'"),
        ({"datacenters.clock_law": PrefillDecodeDvfs()}, "datacenters.clock_law is PrefillDecodeDvfs, .* LinearDvfs()"),
        ({"cost.voltage": "l2"}, "cost.voltage is 'l2'"),
        ({"weights": CostWeights(loss=2.0)}, r"weights.loss is 2, .* set it to 0"),
    ],
)
def test_what_they_cannot_work_with_is_named(make, changed, message):
    with pytest.raises(ValueError, match=message):
        make().reset(make_scenario("toy6", **({"observe": "feeder"} | changed)))


@pytest.mark.parametrize("make", BOTH)
def test_where_agents_stand_must_be_told_where_it_is_drawn(make):
    scenario = make_scenario("ieee123", observe="feeder", horizon=3)
    env, controller = DcgridEnv(scenario), make()
    observation, _ = env.reset(seed=0)
    controller.reset(scenario)
    with pytest.raises(ValueError, match=r"ieee123 draws .* call place\(buses\)"):
        controller.act(observation)
    controller.place(np.zeros((3, 12), np.int64) + np.arange(3)[:, None])
    with pytest.raises(ValueError, match="placed in 3 environments and 1 are observed"):
        controller.act(observation)
