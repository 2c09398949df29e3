"""A storage behind a data centre's converter: driven by the site's agent, within the site's rating."""

import gymnasium
import numpy as np
import pytest
import torch

import dcgrid_env
from dcgrid_env import DcgridVectorEnv, Fault, ScenarioError, TensorEnv, make_scenario
from dcgrid_env.baselines import find_controller, rollout
from dcgrid_env.baselines.model_based.hindsight import hindsight

FIGURES = {"p_rated_kw": 900.0, "energy_kwh": 5.0, "charge_efficiency": 0.9, "ageing_price": 0.05}
STEPS = 20


def scenario(**overrides):
    return make_scenario("ieee33-weak", horizon=STEPS, datacenters={"storage": FIGURES}).replace(**overrides)


def history(s, actions, n_env=1):
    """Draw and reactive limit of the sites, and the storages' states, in each step."""
    env = DcgridVectorEnv(n_env, s)
    env.reset(seed=3)
    states = []
    for action in actions:
        env.step(np.broadcast_to(action, (n_env, len(action))).astype(np.float32))
        states.append(env.transition.state)
    return states


def test_the_agent_of_the_site_drives_it_and_sees_it():
    s = scenario()
    assert [channel for agent, channel in dcgrid_env.action_layout(s).names if agent == "dc_0"] == [
        "clock",
        "q",
        "storage_p",
    ]
    assert dcgrid_env.field_names(s)["dc_2"][-3:] == ("stored", "charge_limit", "discharge_limit")


@pytest.mark.parametrize("asked", [1.0, -1.0])
def test_energy_is_conserved_and_the_rating_of_the_site_holds(asked):
    s, sites = scenario(), slice(0, 3)
    action = np.ones(dcgrid_env.action_layout(s).n)
    action[[2, 5, 8]] = asked
    plain = history(make_scenario("ieee33-weak", horizon=STEPS), [np.ones(10)] * STEPS)
    states = history(s, [action] * STEPS)
    before = None
    for without, now in zip(plain, states, strict=True):
        draw = now.devices[0].storage.storage_kw
        np.testing.assert_allclose(now.p_kw[:, sites], without.p_kw[:, sites] + draw, atol=1e-9)
        assert np.abs(now.p_kw[:, sites]).max() <= 1000.0 + 1e-9
        reach = np.sqrt(np.maximum(1020.0**2 - now.p_kw[:, sites] ** 2, 0.0))
        np.testing.assert_allclose(now.q_limit_kvar[:, sites], np.minimum(330.0, reach))
        if before is not None:
            gained = 0.9 * np.maximum(draw, 0.0) - np.maximum(-draw, 0.0) / 0.95
            np.testing.assert_allclose(now.devices[0].storage.stored_kwh, before + gained / 3600.0, atol=1e-9)
        before = now.devices[0].storage.stored_kwh
    assert np.abs(states[-1].devices[0].storage.throughput_kwh).min() > 0.01


def test_one_environment_a_batch_and_tensors_agree():
    s = scenario()
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (STEPS, dcgrid_env.action_layout(s).n)).astype(np.float32)
    one, batch = gymnasium.make("dcgrid/IEEE33Weak-v0", scenario=s), DcgridVectorEnv(2, s)
    tensors = TensorEnv(s, like=torch.empty(0, dtype=torch.float64))
    one.reset(seed=7)
    batch.reset(seed=[6, 7])
    tensors.reset([7])
    info = {}
    for action in actions:
        _, reward, *_, info = one.step(action)
        _, rewards, *_ = batch.step(np.stack((action, action)))
        step = tensors.step(torch.tensor(action, dtype=torch.float64)[None])
        assert reward == rewards[1]
        assert -step.cost_j.item() == pytest.approx(reward, rel=1e-5)
    assert info["site_stored_kwh"] == pytest.approx(tensors.state.devices[0].storage.stored_kwh.sum().item(), rel=1e-6)


def test_what_is_missing_at_the_end_is_charged():
    class Empties:
        def reset(self, env_info):
            self.action = np.ones(dcgrid_env.action_layout(env_info).n, np.float32)
            self.action[[2, 5, 8]] = -1.0

        def act(self, observations):
            return np.broadcast_to(self.action, (*observations.shape[:-1], len(self.action)))

    figures = rollout(scenario(), Empties(), [0]).metrics()[0]
    assert figures["site_storage_missing_kwh"] > 1.0
    share = 9.0 * figures["site_storage_missing_kwh"] * 3600.0 / 2700.0 / STEPS
    assert figures["cost_site_missing"] == pytest.approx(share)


def test_a_fault_takes_it_from_the_grid_and_it_keeps_its_energy():
    s = scenario(faults=(Fault(("dc_0",), begin_s=(0.0, 0.0)),))
    action = np.ones(dcgrid_env.action_layout(s).n)
    states = history(s, [action] * 3)
    assert all(state.p_kw[0, 0] == 0.0 for state in states)
    assert states[-1].devices[0].storage.stored_kwh[0, 0] == 2.5
    assert states[-1].devices[0].storage.stored_kwh[0, 1] > 2.5


def test_files_and_hashes(tmp_path):
    s = scenario(name="mine")
    s.to_toml(tmp_path / "a.toml")
    again = make_scenario(tmp_path / "a.toml")
    assert again.difference(s) is None
    assert dcgrid_env.scenario_hash(again) == dcgrid_env.scenario_hash(s)
    assert dcgrid_env.scenario_hash(s) != dcgrid_env.scenario_hash(s.replace(datacenters={"storage": None}))


def test_laws_leave_it_at_rest_and_hindsight_refuses_it():
    figures = rollout(scenario(), find_controller("droop", scenario()), [0]).metrics()[0]
    assert figures["site_storage_throughput_kwh"] == 0.0
    with pytest.raises(ValueError, match=r"hindsight plans storages that are agents; .* leave datacenters.storage out"):
        hindsight(scenario(), 0)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"p_rated_kw": 300.0}, "energy_kwh is missing; give it"),
        (FIGURES | {"size": 1.0}, "size is no field; its fields are p_rated_kw, energy_kwh"),
        (FIGURES | {"energy_kwh": -1.0}, "energy_kwh is -1.0; give one positive number"),
        (FIGURES | {"charge_efficiency": 1.1}, "charge_efficiency is 1.1; give one finite number"),
        (FIGURES | {"p_rated_kw": (1.0, 2.0)}, "or one for each of the 3 devices"),
        (300.0, r"datacenters.storage is 300.0; give SiteStorage\(...\) or a mapping of its"),
    ],
)
def test_bad_figures_are_refused_by_name(given, message):
    with pytest.raises(ScenarioError, match=message):
        scenario(datacenters={"storage": given})


def test_beside_a_ups_it_is_refused():
    with pytest.raises(ScenarioError, match="leave it out beside ride_through, or give Storages, agents of their own"):
        scenario(datacenters={"ride_through": "itic"})
