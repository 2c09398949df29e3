"""MPC by agents that exchange measurements: its estimate of all voltages, its cost, and what it refuses."""

import numpy as np
import pytest

from dcgrid_env import DcgridEnv, distflow, make_scenario, parallel_env
from dcgrid_env.baselines import make_controller, rollout
from dcgrid_env.baselines.model_based.message_mpc import MessageMpc
from dcgrid_env.baselines.model_based.mpc import Mpc


class Recording(MessageMpc):
    """Keeps the estimated voltages of each step, (step, row, n_load_node)."""

    def reset(self, env_info):
        super().reset(env_info)
        self.believed = []

    def plan(self, now):
        self.believed.append(now.v_pu)
        return super().plan(now)


def driven(scenario, seeds):
    """Estimated and true voltages at the same times, and the costs, (row,)."""
    controller = Recording()
    recorder = rollout(scenario, controller, seeds)
    load = scenario.feeder.load_slice
    true = np.stack([recorder.series(row).v_pu[:-1, load] for row in range(len(seeds))], axis=1)
    return np.array(controller.believed), true, recorder.costs()


def without_inverters(scenario):
    return scenario.replace(inverters={"buses": ()})


@pytest.mark.parametrize(("name", "rms_pu"), [("das69", 2e-4), ("ieee123", 2e-4), ("ieee34-3ph", 2e-3)])
def test_voltages_of_other_buses_follow_from_those_of_the_agents(name, rms_pu):
    """Voltages vary by 0.003 p.u. and more; taps that move on ieee34-3ph are not measured. Each row of ieee123 has
    another placement."""
    believed, true, _ = driven(make_scenario(name, split="validation", horizon=20), [0, 1, 2])
    assert np.sqrt(((true - true.mean(axis=(0, 1))) ** 2).mean()) > 0.003
    assert np.sqrt(((believed - true)[1:] ** 2).mean()) < rms_pu


def test_an_agent_at_every_bus_sees_every_voltage():
    scenario = make_scenario("toy6", split="validation", inverters={"buses": (1, 2, 3, 5)}, horizon=12)
    assert len(set(scenario.feeder.bus_ids[1:])) == scenario.n_agents == 5
    believed, true, _ = driven(scenario, [0, 1])
    assert np.abs(believed - true).max() < 1e-4


def test_the_weights_by_hand():
    """One agent: of its deviation another bus has Cov(U_i, U_k) / (Var(U_i) + s^2), with U in per unit."""
    noise = 0.004
    scenario = without_inverters(make_scenario("toy6", sensing={"noise_pu": noise}))
    controller = MessageMpc()
    controller.reset(scenario)
    known, points = controller._regression, controller._site.points
    assert known is not None
    v_pu = np.empty((len(points.p_load_kw), 5))
    (bus,) = (scenario.feeder.index(bus) for bus in scenario.datacenters.buses or ())
    for row, (p_kw, q_kvar, drawn_kw) in enumerate(
        zip(points.p_load_kw, points.q_load_kvar, points.p_agent_kw, strict=True)
    ):
        p_kw = p_kw + drawn_kw[0] * (np.arange(6) == bus)
        v_pu[row] = distflow(scenario.feeder, p_kw, q_kvar, scenario.source_voltage_pu).v_pu[1:]
    u = v_pu - (points.p_agent_kw - points.p_agent_kw.mean()) * known.by_p[0, 0]
    covariance = np.cov(u.T, bias=True)
    expected = covariance[bus - 1] / (covariance[bus - 1, bus - 1] + noise**2 + 1e-8)
    np.testing.assert_allclose(known.gain[0, 0], expected, rtol=1e-6)


def test_it_costs_what_mpc_with_all_voltages_costs_and_less_than_the_law():
    scenario = make_scenario("das69", split="validation")
    everything, law = (
        rollout(scenario, make_controller(name), range(4)).costs() for name in ("mpc-one-step", "model-aided")
    )
    messages = rollout(scenario, make_controller("mpc-messages"), range(4)).costs()
    np.testing.assert_allclose(messages, everything, rtol=1e-3)
    assert messages.mean() < law.mean() - 0.005


@pytest.mark.parametrize("spoiled", [{"noise_pu": 0.005, "delay_steps": 2, "preview": False}, {"delay_steps": 1}])
def test_old_and_noisy_measurements(spoiled):
    scenario = make_scenario("ieee33-weak", split="validation", sensing=spoiled)
    costs = {
        name: rollout(scenario, make_controller(name), range(4)).costs().mean()
        for name in ("mpc-messages", "mpc-one-step")
    }
    assert costs["mpc-messages"] < 1.01 * costs["mpc-one-step"]


def test_a_row_does_not_depend_on_the_others_nor_on_the_interface():
    scenario = make_scenario("zero-shot", split="validation", horizon=4)
    seeds = [0, 1, 20]
    joined = rollout(scenario, MessageMpc(), seeds)
    assert joined.costs()[1] == pytest.approx(rollout(scenario, MessageMpc(), [1]).costs()[0], rel=1e-9)
    on = make_scenario("das69", horizon=4)
    recorder, env, controller = rollout(on, MessageMpc(), [3]), parallel_env(on), MessageMpc()
    observations, _ = env.reset(seed=3)
    controller.reset(on)
    costs = []
    while env.agents:
        observations, rewards, *_ = env.step(controller.act(observations))
        costs.append(-rewards["dc_0"])
    assert costs == recorder.series(0).cost_j.tolist()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"observe": "feeder"}, "mpc-messages: observe is 'feeder'; make the scenario with observe='local'"),
        ({"cost.voltage": "l2"}, "mpc-messages: cost.voltage is 'l2'"),
    ],
)
def test_refusals(changed, message):
    with pytest.raises(ValueError, match=message):
        MessageMpc().reset(make_scenario("toy6", **changed))


def test_drawn_buses_require_a_placement():
    scenario, controller = make_scenario("ieee123", horizon=3), MessageMpc()
    observation, _ = DcgridEnv(scenario).reset(seed=0)
    controller.reset(scenario)
    with pytest.raises(ValueError, match=r"mpc-messages: ieee123 draws .* call place\(buses\)"):
        controller.act(observation)


def test_its_horizon_is_one_step_unless_given():
    assert MessageMpc().horizon == 1
    assert isinstance(MessageMpc(horizon=3), Mpc)
