"""The engine on three-phase feeders: phases of devices, observations, charges and metrics."""

from typing import Any

import numpy as np
import pytest
import torch

from dcgrid_env import CostWeights, Fault, ScenarioError, TensorEnv, make_scenario, scenario_hash
from dcgrid_env.engine.cost import observation
from dcgrid_env.engine.exogenous import episode
from dcgrid_env.engine.physics import connections, dynamics
from dcgrid_env.engine.physics.actions import action_layout
from dcgrid_env.engine.record.episode_record import Recorder
from dcgrid_env.engine.simulation import Simulation
from dcgrid_env.powerflow import Control, nema_unbalance, sensitivity, solver_for, three_phase_nodes, unbalance_factor
from helpers.intervals import interval
from helpers.three_phase import SCENARIOS, ieee13, ieee123


def play(scenario, n_env=3, steps=None, seed=0, action=None) -> Any:
    """A batch under random or given actions, its transitions from the reset on."""
    simulation = Simulation(scenario, n_env)
    transitions = [simulation.reset(list(range(n_env)))]
    rng, n = np.random.default_rng(seed), action_layout(scenario).n
    for _ in range(scenario.horizon if steps is None else steps):
        given = rng.uniform(-1.0, 1.0, (n_env, n)) if action is None else np.tile(action, (n_env, 1))
        transitions.append(simulation.step(given))
    return simulation, transitions


@pytest.mark.parametrize("name", SCENARIOS)
def test_loads_and_devices_enter_the_power_flow_where_they_stand(name):
    scenario = SCENARIOS[name]()
    feeder, (simulation, transitions) = scenario.feeder, play(SCENARIOS[name](), steps=2)
    now, state = simulation.now, transitions[-1].state
    outside, _ = interval(scenario, now.episode, now.step, now.noise, now.p_ref_next_kw)
    p, q = outside.p_load_kw.copy(), outside.q_load_kvar.copy()
    for env_index in range(len(p)):
        for agent, bus in enumerate(now.episode.buses[env_index]):
            nodes = feeder.nodes_at(bus)
            legs = feeder.first_device_leg + np.array(nodes)
            p[env_index, legs] += state.p_kw[env_index, agent] / len(nodes)
            q[env_index, legs] -= state.q_kvar[env_index, agent] / len(nodes)
    arrays = outside.p_load_kw, outside.q_load_kvar, outside.legs, state.p_kw, state.q_kvar
    for net in (dynamics.net_loads(*arrays), dynamics.net_loads(*map(torch.tensor, arrays))):
        np.testing.assert_allclose(net, (p, q), rtol=1e-12, atol=1e-9)
    assert np.all(outside.p_load_kw[:, feeder.first_device_leg :] == 0.0)


@pytest.mark.parametrize("name", SCENARIOS)
def test_voltages_are_those_of_the_solver_and_agents_see_their_phases(name):
    scenario = SCENARIOS[name]()
    feeder, (simulation, transitions) = scenario.feeder, play(SCENARIOS[name](), steps=3)
    now, state = simulation.now, transitions[-1].state
    for env_index in range(3):
        for agent, bus in enumerate(now.episode.buses[env_index]):
            v = state.v_pu[env_index, list(feeder.nodes_at(bus))]
            seen = (state.v_agent_pu, state.three_phase.v_agent_lowest_pu, state.three_phase.v_agent_highest_pu)
            assert [field[env_index, agent] for field in seen] == pytest.approx([v.mean(), v.min(), v.max()], abs=1e-14)
    tensors = (torch.tensor(a) for a in (state.three_phase.v_re_pu, state.three_phase.v_im_pu))
    np.testing.assert_allclose(
        state.three_phase.unbalance, unbalance_factor(three_phase_nodes(feeder), *tensors), rtol=1e-12
    )
    phasors = state.three_phase.v_re_pu + 1j * state.three_phase.v_im_pu
    np.testing.assert_allclose(np.abs(phasors), state.v_pu, rtol=1e-12)
    names = observation.field_names(scenario)["dc_0"]
    field = dict(zip(names, transitions[-1].observation[0], strict=False))
    assert field["v_lowest"] <= field["v_deviation"] <= field["v_highest"]
    lowest = state.three_phase.v_agent_lowest_pu[0, 0]
    assert field["v_lowest"] == pytest.approx((lowest - 1.0) / scenario.cost.band_pu, abs=1e-5)


def test_load_noise_is_one_draw_a_bus():
    scenario = ieee13()
    drawn = episode.draw(scenario, np.arange(2, dtype=np.uint64), np.zeros(2, np.uint64))
    factor = np.ones(1)
    for _, outside in episode.unroll(scenario, drawn):
        loaded = scenario.feeder.p_load_kw > 0
        factor = (outside.p_load_kw / np.where(loaded, scenario.feeder.p_load_kw, 1.0))[:, loaded]
        np.testing.assert_allclose(
            (outside.q_load_kvar[:, loaded]), factor * scenario.feeder.q_load_kvar[loaded], rtol=1e-12
        )
        bus = scenario.feeder.leg_bus[loaded]
        for one in np.unique(bus):
            assert np.ptp(factor[:, bus == one], axis=1).max() < 1e-12
    assert np.ptp(factor) > 0.01


@pytest.mark.parametrize("phases", ["a", "b", "ab", "abc"])
def test_one_phase_by_option(phases):
    scenario = ieee13().replace(inverters={"phases": (phases, "abc", "c", "a")}, horizon=4)
    nodes = connections.nodes_by_bus(scenario)[2, scenario.feeder.index("633")]
    expected = [n + scenario.feeder.nodes_of("633")[0] for n in ("abc".index(p) for p in phases)]
    assert sorted(set(nodes.tolist())) == expected
    assert len({np.count_nonzero(nodes == n) for n in expected}) == 1
    full = np.zeros(action_layout(scenario).n)
    _, (_, before) = play(scenario, n_env=1, steps=1, action=full)
    full[4] = 1.0  # the first inverter's reactive power, behind the clocks and reactive powers of two sites
    _, (_, after) = play(scenario, n_env=1, steps=1, action=full)
    moved = (after.state.v_pu - before.state.v_pu)[0, list(scenario.feeder.nodes_of("633"))]
    own = ["abc".index(p) for p in phases]
    assert moved[own].min() > 0.001
    assert moved[own].min() > max([moved[i] for i in range(3) if i not in own], default=0.0)


def test_own_distance_is_the_derivative_of_the_own_voltage():
    scenario = ieee123()
    feeder, h = scenario.feeder, 1.0
    drawn = episode.draw(scenario, np.arange(1, dtype=np.uint64), np.zeros(1, np.uint64))
    placed = drawn.placed
    solve = solver_for(feeder, "sweep")
    for agent in (0, 4, 5, 11):
        at, legs = placed.nodes[0, agent], placed.legs[0, agent]
        p = np.tile(feeder.p_load_kw, (2, 1))
        np.add.at(p[0], legs, -h / len(legs))
        np.add.at(p[1], legs, h / len(legs))
        v = solve(feeder, p, np.tile(feeder.q_load_kvar, (2, 1)), feeder.v0_pu).v_pu[:, at].mean(-1)
        rise = (v[0] - v[1]) / (2.0 * h) * 1000.0
        assert placed.r[0, agent] == pytest.approx(rise / scenario.cost.band_pu, rel=1e-3)
    assert sensitivity(feeder).by_p_pu_per_mw.shape == (feeder.n_node, feeder.n_node)


@pytest.mark.parametrize(
    "overrides",
    [
        {"background.capacitors": False},
        {"source_voltage_pu": 0.95},
        {"sensing.r_model_share": 0.5, "sensing.x_model_share": 2.0},
    ],
)
def test_distances_are_those_of_the_scenario_and_its_error(overrides):
    scenario = ieee13().replace(**overrides)
    feeder, solve = scenario.feeder, solver_for(scenario.feeder, "sweep")
    drawn = episode.draw(scenario, np.arange(1, dtype=np.uint64), np.zeros(1, np.uint64))
    control = Control(capacitor_on=scenario.capacitor_connected)
    n = scenario.n_agents
    for agent in range(n):
        at, legs = drawn.placed.nodes[0, agent], drawn.placed.legs[0, agent]
        load = np.tile(feeder.q_load_kvar, (2, 1))
        np.add.at(load[0], legs, -1.0 / len(legs))
        np.add.at(load[1], legs, 1.0 / len(legs))
        given = (np.tile(feeder.p_load_kw, (2, 1)), load, scenario.source_voltage_pu, control)
        v = solve(feeder, *given).v_pu[:, at].mean(-1)
        rise = (v[0] - v[1]) * 500.0 * scenario.sensing.x_model_share / scenario.cost.band_pu
        assert drawn.placed.x[0, agent] == pytest.approx(rise, rel=1e-3)
    far = scenario.replace(sensing={"r_model_share": 10.0, "x_model_share": 10.0})
    assert np.isfinite(play(far, steps=1)[1][-1].observation).all()


def test_without_a_solution_at_the_reset_every_voltage_is_the_sources():
    scenario = ieee13().replace(
        datacenters={"p_rated_kw": 1e6},
        grid_control={"regulators": "fixed"},
        trace="step",
        workload={"window": "start"},
    )
    scenario = scenario.replace(source_voltage_pu=0.5)
    _, (begun, *_) = play(scenario, steps=0)
    assert not begun.converged.any()
    state = begun.state
    for seen in (state.v_pu, state.three_phase.v_agent_lowest_pu, state.three_phase.v_agent_highest_pu):
        np.testing.assert_allclose(seen, 0.5)
    np.testing.assert_allclose(np.hypot(state.three_phase.v_re_pu, state.three_phase.v_im_pu), 0.5)


@pytest.mark.parametrize("observe", ["local", "neighbours", "feeder"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_observations_lie_within_their_bounds(name, observe):
    scenario = SCENARIOS[name]().replace(observe=observe, sensing={"noise_pu": 0.002, "delay_steps": 1}, horizon=6)
    low, high = observation.joint_bounds(scenario)
    _, transitions = play(scenario)
    for t in transitions:
        assert t.observation.shape[1] == len(low) == sum(map(len, observation.field_names(scenario).values()))
        assert np.isfinite(t.observation).all()
        assert ((t.observation >= low) & (t.observation <= high)).all()
    if observe == "feeder":
        assert f"v_deviation_{scenario.feeder.node_ids[-1]}" in observation.field_names(scenario)["dc_0"]


def test_unbalance_is_charged_on_request_and_measured():
    plain, charged = ieee13(), ieee13().replace(weights=CostWeights(unbalance=1000.0))
    _, before = play(plain)
    _, after = play(charged)
    recorder = Recorder(charged, after[0])
    for was, now in zip(before[1:], after[1:], strict=True):
        expected = 1000.0 * (now.state.three_phase.unbalance**2).mean(-1)
        np.testing.assert_allclose(now.costs.unbalance, expected, rtol=1e-12)
        np.testing.assert_allclose(now.cost_j, was.cost_j + expected, rtol=1e-12)
        assert (was.costs.unbalance == 0.0).all()
        recorder.add(now)
    figures = recorder.metrics()[0]
    factor = np.array([t.state.three_phase.unbalance[0] for t in after[1:]])
    assert figures["unbalance_max_pct"] == pytest.approx(100.0 * factor.max())
    assert figures["unbalance_mean_pct"] == pytest.approx(100.0 * factor.mean())
    assert 0.5 < figures["unbalance_mean_pct"] < 3.0
    states = [t.state.three_phase for t in after[1:]]
    nema = [nema_unbalance(three_phase_nodes(plain.feeder), s.v_re_pu[0], s.v_im_pu[0]).max() for s in states]
    assert figures["nema_unbalance_max_pct"] == pytest.approx(100.0 * max(nema))
    own = ieee13().replace(weights=CostWeights(unbalance=1000.0), reward="local")
    without = ieee13().replace(reward="local")
    rewards = [play(s)[1][-1].reward for s in (without, own)]
    np.testing.assert_allclose(rewards[0] - rewards[1], np.tile(after[-1].costs.unbalance[:, None], 6), rtol=1e-9)


def test_capacitors_are_off_or_lost():
    scenario = ieee13().replace(horizon=6)
    off = scenario.replace(background={"capacitors": False})
    lost = scenario.replace(faults=(Fault(("capacitor",), begin_s=(2.0, 2.0), duration_s=(2.0, 2.0)),))
    still = np.zeros(action_layout(scenario).n)
    v, v_off, v_lost = (np.array([t.state.v_pu[0] for t in play(s, action=still)[1]]) for s in (scenario, off, lost))
    assert (v - v_off).mean() > 0.005
    struck = np.abs(v - v_lost).max(-1) > 1e-4
    assert struck.tolist() == [False, False, False, True, True, False, False]


@pytest.mark.slow
def test_past_the_collapse_the_episode_ends_and_nothing_is_nan():
    scenario = ieee13().replace(
        datacenters={"p_rated_kw": 60_000.0}, trace="step", workload={"window": "start"}, horizon=30
    )
    _, transitions = play(scenario, action=np.array([1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    ended = [t for t in transitions if t.terminated.all()]
    assert ended
    for t in transitions:
        *phases, (regulators, banks) = t.state.three_phase
        arrays = [t.reward, t.observation, t.cost_j, t.state.v_pu, t.loss_kw, *t.costs, *phases, *regulators, *banks]
        assert all(np.isfinite(a).all() for a in arrays)


@pytest.mark.parametrize("name", SCENARIOS)
def test_an_environment_is_the_same_alone_and_after_saving(name):
    scenario = SCENARIOS[name]()
    _, batch = play(scenario, n_env=4, steps=5)
    alone = Simulation(scenario, 1)
    alone.reset([2])
    rng = np.random.default_rng(0)
    for k in range(5):
        given = rng.uniform(-1.0, 1.0, (4, action_layout(scenario).n))
        if k == 3:
            alone.restore(alone.now)
        transition = alone.step(given[2:3])
        np.testing.assert_array_equal(transition.state.v_pu[0], batch[k + 1].state.v_pu[2])
        np.testing.assert_array_equal(transition.observation[0], batch[k + 1].observation[2])
        assert transition.reward[0] == batch[k + 1].reward[2]


def test_tensors_step_alike_and_carry_a_derivative():
    scenario = ieee13().replace(horizon=4, weights=CostWeights(unbalance=100.0))
    _, transitions = play(scenario, n_env=2)
    env = TensorEnv(scenario, like=torch.empty(0, dtype=torch.float64))
    env.reset(range(2))
    rng, total, given = np.random.default_rng(0), torch.zeros(()), []
    for t in transitions[1:]:
        action = torch.tensor(rng.uniform(-1.0, 1.0, (2, action_layout(scenario).n)), requires_grad=True)
        step = env.step(action)
        given.append(action)
        np.testing.assert_allclose(step.cost_j.detach().numpy(), t.cost_j, rtol=1e-6)
        total = total + step.cost_j.sum()
    total.backward()
    slopes = torch.stack([action.grad for action in given])
    assert torch.isfinite(slopes).all()

    def cost(first):
        simulation = Simulation(scenario, 2)
        simulation.reset([0, 1])
        actions = [first, *(a.detach().numpy() for a in given[1:])]
        return sum(simulation.step(a).cost_j.sum() for a in actions)

    base, h = given[0].detach().numpy(), 1e-4
    for env_index, entry in ((0, 0), (0, 1), (1, 5), (1, 7)):
        move = np.zeros_like(base)
        move[env_index, entry] = h
        slope = (cost(base + move) - cost(base - move)) / (2.0 * h)
        assert slopes[0, env_index, entry].item() == pytest.approx(slope, rel=1e-3, abs=1e-5)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"power_flow": "distflow"}, "power_flow is 'distflow'; give 'sweep' for the three-phase feeder"),
        ({"inverters.phases": "d"}, "inverters.phases is 'd'; give one of a, b, c"),
        ({"inverters.phases": ("a", "b")}, "or one for each of the 4 devices"),
        ({"inverters.phases": ("a", "b", "a", "a")}, "bus '611' has the phases c, not a"),
        ({"datacenters.phases": "ba"}, "datacenters.phases is 'ba'"),
        ({"inverters.buses": ("sourcebus", "675", "611", "652")}, "inverters.buses has the substation 'sourcebus'"),
        ({"datacenters.buses": None, "n_datacenters": 9}, "only 4 load buses have no device"),
    ],
)
def test_what_cannot_be_is_refused(overrides, message):
    with pytest.raises(ScenarioError, match=message) as raised:
        ieee13().replace(**overrides)
    assert len(str(raised.value).splitlines()) == 1


def test_balanced_feeders_have_no_phases_and_keep_their_hashes():
    with pytest.raises(ScenarioError, match="is balanced and has no phases 'a'; leave the phases out"):
        make_scenario("ieee33", inverters={"phases": "a"})
    with pytest.raises(ScenarioError, match="power_flow is 'sweep'; give 'distflow' or 'lindistflow'"):
        make_scenario("ieee33", power_flow="sweep")
    assert scenario_hash(ieee13()) != scenario_hash(ieee13().replace(inverters={"phases": ("a", "abc", "c", "a")}))


def test_drawn_sites_stand_at_buses_of_three_phases():
    scenario = ieee123()
    at = {scenario.feeder.bus_phases[i] for i in scenario.candidates}
    assert at == {"abc"}
    single = scenario.replace(datacenters={"phases": "b"}, inverters={"buses": (54,)})
    assert {scenario.feeder.bus_phases[i] for i in single.candidates} >= {"abc", "b"}
