"""Storages as agents: every environment runs them alike, charges them and refuses bad figures by name."""

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

import dcgrid_env
from dcgrid_env import DcgridVectorEnv, Fault, Recorder, ScenarioError, Storages, TensorEnv, make_scenario
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.devices import Device
from dcgrid_env.devices.storage import sizes
from helpers.storages import FIGURES, toy6_storage
from helpers.three_phase import ieee13

MUCH: Any = "much"
NONE: Any = None
WITH_Q = {"s_rated_kva": (400.0, 500.0)}


def test_its_agents_actions_and_observations():
    s = toy6_storage(figures=WITH_Q)
    assert isinstance(s.devices[-1], Device)
    assert s.agents == ("dc_0", "inv_0", "inv_1", "sto_0", "sto_1")
    assert dcgrid_env.action_layout(s).names[-4:] == (("sto_0", "p"), ("sto_0", "q"), ("sto_1", "p"), ("sto_1", "q"))
    assert dcgrid_env.field_names(s)["sto_0"][-3:] == ("stored", "charge_limit", "discharge_limit")
    assert [name for _, name in dcgrid_env.action_layout(toy6_storage()).names[-2:]] == ["p", "p"]
    env = dcgrid_env.parallel_env(s)
    observations, infos = env.reset(seed=0)
    assert infos["sto_0"]["bus"] == infos["dc_0"]["bus"] == 4
    np.testing.assert_allclose(observations["sto_1"][-3:], [0.5, 1.0, 1.0])
    for _ in range(3):
        observations, *_ = env.step({agent: env.action_space(agent).sample() for agent in env.agents})
        assert all(env.observation_space(agent).contains(observations[agent]) for agent in env.agents)


def test_reactive_power_is_what_active_power_leaves_of_the_converter():
    s = toy6_storage(figures=WITH_Q)
    env = DcgridVectorEnv(1, s)
    env.reset(seed=0)
    env.step(np.ones((1, 8), np.float32))
    np.testing.assert_allclose(env.transition.state.p_kw[0, 3:], [300.0, 300.0])
    np.testing.assert_allclose(env.transition.state.q_kvar[0, 3:], np.sqrt(np.array([400.0, 500.0]) ** 2 - 300.0**2))


@pytest.mark.parametrize("base", [toy6_storage(), None], ids=["balanced", "three phases"])
def test_one_environment_a_batch_agents_and_tensors_agree(base):
    s = base
    if s is None:
        grid = ieee13().replace(horizon=10)
        at = grid.datacenters.buses[0]
        storages = Storages(buses=(at, "692"), phases=("abc", "c"), s_rated_kva=300.0, **FIGURES)
        s = grid.replace(name="storage", devices=(*grid.devices, storages))
    n, rng = dcgrid_env.action_layout(s).n, np.random.default_rng(0)
    actions = rng.uniform(-1.0, 1.0, (s.horizon, n)).astype(np.float32)
    one, batch = gymnasium.make("dcgrid/Toy6-v0", scenario=s), DcgridVectorEnv(2, s)
    agents = dcgrid_env.parallel_env(s)
    tensors = TensorEnv(s, like=torch.empty(0, dtype=torch.float64))
    one.reset(seed=7)
    batch.reset(seed=[6, 7])
    agents.reset(seed=7)
    tensors.reset([7])
    last, over = {}, False
    for action in actions:
        _, reward, _, over, info = one.step(action)
        _, rewards, *_ = batch.step(np.stack((action, action)))
        _, paid, *_ = agents.step(dcgrid_env.action_layout(s).split(action))
        step = tensors.step(torch.tensor(action, dtype=torch.float64)[None])
        assert reward == rewards[1] == next(iter(paid.values()))
        assert -step.cost_j.item() == pytest.approx(reward, rel=1e-5)
        last = info
    assert over
    state = tensors.state
    for name in ("stored_kwh", "throughput_kwh", "storage_loss_kwh", "missing_kwh"):
        key = name if name.startswith("stor") else f"storage_{name}"
        assert last[key] == pytest.approx(getattr(state, name).sum().item(), rel=1e-6, abs=1e-9)


def test_what_is_charged_is_throughput_and_what_is_missing_at_the_end():
    s = toy6_storage(horizon=10, figures={"discharge_efficiency": 0.8})
    env = DcgridVectorEnv(1, s)
    env.reset(seed=[0])
    recorder, action = Recorder(s, env.transition), np.zeros((1, 6), np.float32)
    action[:, 4] = -0.5
    while not recorder.over:
        env.step(action)
        recorder.add(env.transition)
    metrics = recorder.series(0).metrics()
    given = 150.0 * 10 / 3600.0
    assert metrics["storage_throughput_kwh"] == pytest.approx(given)
    assert metrics["storage_missing_kwh"] == pytest.approx(given / 0.8)
    assert metrics["storage_loss_kwh"] == pytest.approx(given / 0.8 - given)
    assert metrics["stored_end_pct"] == metrics["stored_lowest_pct"] == pytest.approx(50.0 - 10.0 * given / 0.8)
    assert metrics["cost_ageing"] == pytest.approx(0.05 * 150.0 / 600.0)
    assert metrics["cost_missing"] == pytest.approx(9.0 * given / 0.8 * 3600.0 / 600.0 / 10)


def test_local_costs_and_the_largest_cost_are_the_slots_own():
    s = toy6_storage(horizon=2, figures={"ageing_price": (0.5, 0.0)}, reward="local")
    env = dcgrid_env.parallel_env(s)
    env.reset(seed=0)
    action = {agent: np.zeros(env.action_space(agent).shape or (), np.float32) for agent in env.agents}
    *_, infos = env.step(action | {"sto_0": np.ones(1, np.float32), "sto_1": np.ones(1, np.float32)})
    assert [infos[agent]["cost_ageing"] for agent in ("sto_0", "sto_1")] == pytest.approx([0.25, 0.25])  # the team's
    term = {term.name: term for term in s.devices[-1].cost_terms(2, 1.0)}
    assert term["ageing"].largest == 0.5
    assert term["missing"].largest == pytest.approx(9.0 * 2.5 * 3600.0 / 300.0)


def test_a_storage_that_a_fault_takes_from_the_grid_keeps_its_energy():
    lost = Fault(("storage",), begin_s=(0.0, 0.0), duration_s=(3.0, 3.0))
    s = toy6_storage(horizon=6, figures={"charge_efficiency": 1.0}, faults=(lost,))
    env = DcgridVectorEnv(1, s)
    env.reset(seed=[1])
    drawn, stored = [], []
    for _ in range(6):
        env.step(np.ones((1, 6), np.float32))
        drawn.append(env.transition.state.p_kw[0, 3:])
        stored.append(env.transition.state.stored_kwh[0])
    drawn, stored = np.array(drawn), np.array(stored)
    assert sorted((drawn == 0.0).sum(axis=0)) == [0, 3]
    np.testing.assert_allclose(stored, 2.5 + np.cumsum(drawn, axis=0) / 3600.0)


def test_a_storage_stands_where_a_site_does_and_two_storages_do_not():
    s = toy6_storage()
    assert s.devices[-1].buses == ("4", "2")
    with pytest.raises(ScenarioError, match="buses has '4', where another storage is; give each its own"):
        s.replace(devices=(*s.devices[:2], Storages(buses=(4, 4), **FIGURES)))
    with pytest.raises(ScenarioError, match="has the substation"):
        s.replace(devices=(*s.devices[:2], Storages(buses=(s.feeder.bus_ids[0],), **FIGURES)))


def test_scenario_files_and_hashes(tmp_path):
    s = toy6_storage(figures=WITH_Q)
    s.to_toml(tmp_path / "a.toml")
    again = make_scenario(tmp_path / "a.toml")
    assert again.difference(s) is None
    assert dcgrid_env.scenario_hash(again) == dcgrid_env.scenario_hash(s) != dcgrid_env.scenario_hash(toy6_storage())


def test_sizes_from_a_capacitor_to_hours():
    capacitors = Storages.supercapacitors((4,), gpus=1000)
    assert capacitors.parameters.energy_kwh[0] * 3.6e6 == pytest.approx(65.0 * 1000)
    assert capacitors.parameters.p_rated_kw[0] == pytest.approx(420.0)
    ups, bess = Storages.ups((4, 2), (100.0, 200.0)), Storages.bess((2,), 100.0, hours=4.0, initial_share=0.25)
    np.testing.assert_allclose(ups.parameters.energy_kwh, np.array([100.0, 200.0]) * sizes.UPS_MINUTES / 60.0)
    assert bess.parameters.initial_kwh[0] == pytest.approx(100.0)
    assert bess.parameters.charge_efficiency[0] * bess.parameters.discharge_efficiency[0] == pytest.approx(
        sizes.BESS_ROUND_TRIP
    )


@pytest.mark.parametrize(
    ("figures", "message"),
    [
        ({"energy_kwh": -5.0}, "energy_kwh is -5.0; give one positive number of at most 1e"),
        ({"p_rated_kw": 0.0}, "p_rated_kw is 0.0; give one positive number"),
        (
            {"p_rated_kw": (1.0, 2.0, 3.0)},
            r"p_rated_kw is \(1.0, 2.0, 3.0\); .* or one for each of the 2 devices",
        ),
        ({"charge_efficiency": 1.1}, r"charge_efficiency is 1.1; give one finite number in \[0.01, 1\]"),
        ({"discharge_efficiency": (0.9, float("nan"))}, r"discharge_efficiency is \(0.9, nan\); give one finite"),
        ({"standby_share_per_h": 1.0}, r"standby_share_per_h is 1.0; give one finite number in \[0, 0.99\]"),
        ({"initial_share": 2.0}, "initial_share is 2.0"),
        ({"returned_share": 0.0}, "returned_share is 0.0"),
        ({"missing_price": 0.0}, r"missing_price is 0.0; give one finite number in \[0.001, 1e\+06\]"),
        ({"ageing_price": -1.0}, "ageing_price is -1.0"),
        ({"ageing_price": "dear"}, "ageing_price is 'dear'"),
        ({"s_rated_kva": 200.0}, "s_rated_kva is 200.0; give at least p_rated_kw = 300.0, or None"),
        ({"phases": "d"}, "phases is 'd'; give one of a, b, c"),
        ({"buses": 4}, "buses is 4; give a tuple of buses"),
    ],
)
def test_bad_figures_are_refused_by_name(figures, message):
    with pytest.raises(ValueError, match=f"^Storages: {message}"):
        Storages(**({"buses": (4, 2)} | FIGURES | figures))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Storages.ups((4, 2), MUCH), "p_rated_kw is 'much'; give one positive number, or one for each of 2"),
        (lambda: Storages.ups((4, 2), (1.0, 2.0, 3.0)), r"p_rated_kw is \(1.0, 2.0, 3.0\); give one positive number"),
        (lambda: Storages.ups((4,), 1.0, minutes=-5.0), "minutes is -5.0; give one positive number"),
        (lambda: Storages.bess((4,), 1.0, hours=float("inf")), "hours is inf; give one positive number"),
        (lambda: Storages.supercapacitors((4,), gpus=0), "gpus is 0; give one positive number"),
        (lambda: Storages.bess(NONE, 1.0), "buses is None; give a tuple of buses"),
    ],
)
def test_bad_sizes_are_refused_by_name(make, message):
    with pytest.raises(ValueError, match=f"^Storages: {message}"):
        make()


def test_a_bad_figure_of_a_scenario_file_is_named_with_its_path():
    wrong = {
        "kind": "storage",
        "buses": ["2"],
        "p_rated_kw": 1.0,
        "energy_kwh": 1.0,
        "charge_efficiency": 2.0,
    }
    with pytest.raises(ScenarioError, match=r"devices\[0\].charge_efficiency is 2.0; give one finite number"):
        make_scenario("toy6").replace(devices=[wrong])


def test_random_steps_stay_finite_and_rest_costs_stand_by_alone():
    s = toy6_storage(figures={"standby_share_per_h": 0.1})
    idle = rollout(s, NoControl(), [0]).metrics()[0]
    assert idle["storage_throughput_kwh"] == 0.0
    assert 0.0 < idle["storage_missing_kwh"] == pytest.approx(5.0 * (1.0 - 0.9 ** (21.0 / 3600.0)))
    env = DcgridVectorEnv(64, s)
    env.reset(seed=0)
    rng = np.random.default_rng(1)
    for _ in range(60):
        observation, reward, *_ = env.step(rng.uniform(-1.0, 1.0, (64, 6)).astype(np.float32))
        assert np.isfinite(observation).all()
        assert np.isfinite(reward).all()


def test_a_collapse_is_charged_at_the_largest_cost():
    s = toy6_storage(figures={"p_rated_kw": 1e6, "energy_kwh": 1e4, "initial_share": 0.1})
    env = DcgridVectorEnv(1, s)
    env.reset(seed=0)
    env.step(np.ones((1, 6), np.float32))
    transition = env.transition
    assert transition.terminated[0]
    costs: Any = transition.costs
    assert costs.ageing[0] == pytest.approx(0.05 * s.horizon)
    assert costs.missing[0] == pytest.approx(9.0 * 1e3 * 3600.0 / 1e6)
    assert np.isfinite(transition.state.v_pu).all()
