"""The examples that need only what the tests install: they run, and treat the ends of episodes as they should."""

import importlib.util
import re
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from dcgrid_env import make_scenario
from dcgrid_env.agents import Card, Policy, find_controller, sb3_vec_env, training_env
from dcgrid_env.baselines import rollout
from dcgrid_env.cli.main import main as dcgrid
from helpers.places import ROOT

EXAMPLES = ROOT / "docs" / "examples"
OWN_POLICY = (ROOT / "docs" / "own-policy.md").read_text()


def example(name):
    found = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert found is not None
    assert found.loader is not None
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def printed_figures(capsys):
    line = capsys.readouterr().out.strip().splitlines()[-1]
    return [float(x) for x in re.findall(r"\d+\.\d+", line)]


def mean_j(scenario, controller, episodes):
    validation = make_scenario(scenario, split="validation")
    return float(rollout(validation, controller, range(episodes)).costs().mean())


@pytest.fixture
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.mark.usefixtures("one_thread")
@pytest.mark.slow
def test_plain_sb3_and_its_model_as_a_class_of_ones_own(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    before, after = example("sb3_plain").main(steps=1, num_envs=1, episodes=2, save=Path("results/sb3_plain.zip"))
    assert printed_figures(capsys)[:2] == pytest.approx([before, after], abs=0.00051)
    assert before != after
    (block,) = [b for b in re.findall(r"```python\n(.*?)```", OWN_POLICY, re.DOTALL) if "class Mine:" in b]
    Path("mine.py").write_text(block)
    validation = make_scenario("ieee123", split="validation")
    assert mean_j("ieee123", find_controller("mine.py:Mine", validation), 2) == after


@pytest.mark.slow
@pytest.mark.usefixtures("one_thread")
@pytest.mark.filterwarnings("ignore:Training and eval env")
def test_unmodified_sb3_beats_the_droop_in_a_short_training(tmp_path, capsys):
    found = example("sb3_vec_env").main(steps=30_000, num_envs=16, episodes=8, save=tmp_path / "made")
    assert printed_figures(capsys)[0] == pytest.approx(found, abs=0.00051)
    assert found > 0.2
    assert (tmp_path / "made" / "best_model.zip").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("one_thread")
@pytest.mark.parametrize("change", ["none", "reward", "observation", "weights", "sensing"])
def test_custom_rewards_and_observations_are_scored_on_the_standard_j(change, capsys):
    found = example("custom_training").main(change, steps=2_000, num_envs=8, episodes=2)
    assert printed_figures(capsys)[0] == pytest.approx(abs(found), abs=0.00051)  # figures without their signs
    assert -2.0 < found < 1.0


def constrained_rows(**fields):
    """Rows with violations in every episode, and actions of an episode of 4 steps."""
    common: dict[str, Any] = {"view": "shared", "outputs": "setpoint", "reward": "shared"}
    common |= {"horizon": 4, "source_voltage_pu": 0.95}
    rows = sb3_vec_env("ieee33-weak", 2, **common, **fields)
    rows.seed(0)
    return rows, np.random.default_rng(0).uniform(-0.3, 0.3, (4, rows.num_envs, 2)).astype(np.float32)


def test_constrained_returns_are_those_without_a_weight_of_the_violation():
    constrained = example("constrained_ppo")
    rows, actions = constrained_rows()
    without = constrained.Constrained(constrained_rows(weights={"violation": 0.0})[0])
    wrapped = constrained.Lagrangian(rows)
    wrapped.multiplier = 3.0
    wrapped.reset()
    without.reset()
    j = []
    for action in actions:
        paid, infos = wrapped.step(action)[1::2]
        free = without.step(action)[1]
        cost = np.array([info["cost"] for info in infos])
        assert cost.min() > 0.0
        np.testing.assert_allclose(paid, (free - 3.0 * cost) / 4.0, rtol=1e-4)
        j = [info.get("J") for info in infos[:: rows.rows_per_env]]
    returns, costs = np.array(wrapped.ended).T
    np.testing.assert_allclose(costs - returns, j, rtol=1e-6)
    update = constrained.MultiplierUpdate(wrapped, budget=costs.mean() / 1.5, rate=0.2)
    update._on_rollout_end()  # 50 % above the budget
    assert wrapped.multiplier == pytest.approx(3.0 * np.exp(0.2 * 0.5))
    assert wrapped.ended == []


def test_saute_observes_what_is_left_of_the_budget_and_pays_a_penalty_without():
    constrained = example("constrained_ppo")
    rows, actions = constrained_rows()
    plain = constrained.Constrained(rows)
    plain.reset()
    costs = np.array([[info["cost"] for info in plain.step(action)[3]] for action in actions])
    budget = float(costs[:2].sum(axis=0).max()) / 4 + 1e-9  # spent in the third step
    rows, _ = constrained_rows()
    saute = constrained.Saute(rows, budget, penalty=7.0)
    observation, left, infos = saute.reset(), np.zeros(0), []
    assert observation.shape[1:] == saute.observation_space.shape
    assert (observation[:, -1] == 1.0).all()
    for t, action in enumerate(actions):
        observation, paid, done, infos = saute.step(action)
        left = np.maximum(1.0 - costs[: t + 1].sum(axis=0) / (4 * budget), -1.0)
        if not done.all():
            np.testing.assert_allclose(observation[:, -1], left, atol=1e-5)
        assert ((paid == -7.0) == (left < 0.0)).all()
    np.testing.assert_allclose([info["terminal_observation"][-1] for info in infos], left, atol=1e-5)
    assert (observation[:, -1] == 1.0).all()  # of the next episode
    assert (left < 0.0).all()


@pytest.mark.slow
@pytest.mark.usefixtures("one_thread")
@pytest.mark.parametrize("method", ["lagrangian", "saute", "none"])
def test_constrained_ppo(method, tmp_path, capsys):
    constrained = example("constrained_ppo")
    small = {"steps": 240, "num_envs": 2, "episodes": 2, "save": tmp_path / "made" / "model.zip"}
    found = constrained.main(method=method, **small)
    printed = capsys.readouterr().out.splitlines()
    assert (
        printed[-1]
        == f"{method}: return {found.free:.3f}, cost {found.cost:.4f}, {found.over:.2f} of episodes over budget"
    )
    assert {path.name for path in (tmp_path / "made").iterdir()} == {"model.zip", "model.pkl"}
    test = make_scenario("ieee33-weak", split="test")
    droop = rollout(test, find_controller("droop-tuned", test), range(2)).costs().mean()
    free, cost = map(float, re.findall(r"-?\d+\.\d{3,}", printed[0]))
    assert cost - free == pytest.approx(droop, abs=1e-3)
    with pytest.raises(ValueError, match="budget: must be positive"):
        constrained.main(budget=0.0)


@pytest.mark.usefixtures("one_thread")
@pytest.mark.slow
def test_cleanrl_ppo_learns_and_its_policy_acts_as_its_network_does(tmp_path, capsys):
    cleanrl = example("cleanrl_ppo")
    found = cleanrl.main(steps=30_000, num_envs=16, episodes=8, save=tmp_path / "made")
    assert printed_figures(capsys)[0] == pytest.approx(found, abs=0.00051)
    assert found > 0.2
    assert set(Policy.load(tmp_path / "made.safetensors").networks) == {"datacenter", "inverter"}
    envs = training_env("ieee33-weak", 3)
    agent = cleanrl.Agent(envs)
    torch.nn.init.normal_(agent.actor[-1].weight)  # so that some actions leave the range
    rows, joint = envs.reset(seed=0)[0], gymnasium.make_vec("dcgrid/IEEE33Weak-v0", num_envs=3).reset(seed=0)[0]
    with torch.no_grad():
        mean = agent.actor(torch.as_tensor(rows)).numpy()
    assert np.abs(mean).max() > 1.0
    policy = agent.policy(envs)
    policy.reset(make_scenario("ieee33-weak"))
    expected = envs.rows.joint_action(joint, mean.clip(-1.0, 1.0))
    np.testing.assert_allclose(policy.act(joint), expected, atol=1e-5)


@pytest.mark.usefixtures("one_thread")
@pytest.mark.parametrize("temperature", [None, 0.5])
def test_offline_learning_and_its_policy_without_torch(temperature, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "sets"))
    dcgrid(["dataset", "--controller", "droop", "--noise", "0.2", "--episodes", "3", "--set", "horizon=8"])
    name, small = "dcgrid/ieee33-weak/droop-noise-0_2-v0", {"rounds": 1, "epochs": 2, "batch": 8, "episodes": 2}
    found, droop = example("offline_awr").main([name], temperature=temperature, **small, save=tmp_path / "made")
    assert printed_figures(capsys) == pytest.approx([found, droop], abs=0.00051)
    validation = make_scenario("ieee33-weak", split="validation", horizon=8)
    kept = Policy.load(tmp_path / "made.safetensors")
    assert float(rollout(validation, kept, range(2)).costs().mean()) == pytest.approx(found, rel=1e-12)
    card = Card.load(tmp_path / "made.json")
    assert card.algorithm == ("behaviour-cloning" if temperature is None else "awr")


@pytest.mark.slow
def test_offline_episodes_of_the_same_seed_are_held_against_each_other(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    for name in ("none", "droop"):
        dcgrid(["dataset", "--controller", name, "--episodes", "3", "--set", "horizon=8"])
    awr, both = example("offline_awr"), [f"dcgrid/ieee33-weak/{name}-v0" for name in ("none", "droop")]
    data = awr.Data(both)
    better = awr.compared(data, data.reward, 1.0).reshape(6, 8)
    torch.testing.assert_close(better[:3], -better[3:])  # of two, one is as much above the mean as the other below
    apart = (data.reward[3:] - data.reward[:3]).sum(dim=1)  # undiscounted, from the first step on
    torch.testing.assert_close(2.0 * better[3:, 0], apart)
    with pytest.raises(ValueError, match="seed 0 stands in the data once"):
        awr.main(both[:1], paired=True, epochs=1)
    awr.main(both, paired=True, epochs=1, batch=8, episodes=2, save=tmp_path / "made")
    assert Policy.load(tmp_path / "made.safetensors").trained_on == "ieee33-weak"


def test_offline_returns_count_the_last_value():
    # gamma 0.5: with lambda 1 the discounted sum and a quarter of the last value; with lambda 0 a step and its value.
    reward, value = torch.tensor([[1.0, 2.0]]), torch.tensor([[0.0, 6.0, 8.0]])
    returns = example("offline_awr").returns
    assert returns(reward, value, 0.5, 1.0).tolist() == [[1.0 + 0.5 * 2.0 + 0.25 * 8.0, 2.0 + 0.5 * 8.0]]
    assert returns(reward, value, 0.5, 0.0).tolist() == [[1.0 + 0.5 * 6.0, 2.0 + 0.5 * 8.0]]
