"""The examples that need the ``frameworks`` extra, in separate processes, where the frameworks may warn."""

import importlib.util
import os
import re
import subprocess
import sys

import pytest

from dcgrid_env.agents import Policy
from dcgrid_env.core.suggestions import from_clone
from helpers.places import ROOT

EXAMPLES = ROOT / "docs" / "examples"
LIMIT_S = 420


def needs(*modules, extra="frameworks"):
    """Skip without these modules; "tree" comes with RLlib, and not with the extra ray alone."""
    missing = [module for module in modules if importlib.util.find_spec(module) is None]
    why = f"{', '.join(missing)} not installed; {from_clone(extra)}"
    return pytest.mark.skipif(bool(missing), reason=why)


def run(*arguments, home):
    """Run Python with one thread and a separate home for Ray's files; return its standard output."""
    environment = os.environ | {"OMP_NUM_THREADS": "1", "RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "disabled"}
    done = subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        env=environment | {"HOME": str(home)},
        cwd=home,
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    return done.stdout


def figures(printed):
    return [float(figure) for figure in re.findall(r"\d+\.\d{3}", printed.strip().splitlines()[-1])]


def j_of_the_class(name, home):
    """Mean J, to three digits, that a controller class of docs/own-policy.md reaches on two validation episodes."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "own-policy.md").read_text(), re.DOTALL)
    (block,) = [block for block in blocks if f"class {name}:" in block]
    (home / "mine.py").write_text(block)
    code = f"""
from dcgrid_env import make_scenario
from dcgrid_env.baselines import find_controller, rollout
validation = make_scenario("ieee33-weak", split="validation")
print(f"{{rollout(validation, find_controller('mine.py:{name}', validation), range(2)).costs().mean():.3f}}")
"""
    (j,) = figures(run("-c", code, home=home))
    return j


def check_trained(printed, path):
    before, after, droop = figures(printed)
    assert before != after
    assert 2.0 < droop < after < 10.0
    policy = Policy.load(path)
    assert set(policy.networks) == {"datacenter", "inverter"}
    assert policy.trained_on == "ieee33-weak"


@pytest.mark.slow
@needs("torchrl", "tensordict")
def test_torchrl_wrapper_takes_the_environment_without_info(tmp_path):
    code = """
import dcgrid_env
from torchrl.envs import PettingZooWrapper
from torchrl.envs.utils import check_env_specs
for name in ("toy6", "ieee33-weak", "mixed", "fault", "robust"):
    env = PettingZooWrapper(dcgrid_env.parallel_env(name, horizon=4, info="none"), seed=0, return_state=True)
    check_env_specs(env)
    found = env.rollout(8, break_when_any_done=False)["next"]
    assert found["done"].squeeze().tolist() == [False, False, False, True] * 2, name
    assert found["truncated"].equal(found["done"]) and not found["terminated"].any(), name
    for group, agents in env.group_map.items():
        assert found[group, "done"].shape == (8, len(agents), 1), name
        assert found[group, "reward"].isfinite().all(), name
check_env_specs(PettingZooWrapper(dcgrid_env.env("toy6", info="none"), use_mask=True))
print("checked")
"""
    assert run("-c", code, home=tmp_path).endswith("checked\n")


@pytest.mark.slow
@needs("torchrl", "tensordict")
def test_torchrl_makes_the_gymnasium_id_and_reads_its_info(tmp_path):
    code = """
import dcgrid_env, torch
from torchrl.data import Unbounded
from torchrl.envs import GymEnv, default_info_dict_reader
from torchrl.envs.utils import check_env_specs
NAME = "dcgrid/IEEE33Weak-v0"
ends = [False, False, False, True] * 2

env = GymEnv(NAME, horizon=4)
check_env_specs(env)
assert env.rollout(8, break_when_any_done=False)["next", "truncated"].squeeze().tolist() == ends

env = GymEnv(NAME, horizon=4)  # a reader of chosen figures, whose types are given
types = {"J": torch.float64, "cost": torch.float64, "bus_dc_0": torch.int64}
env.set_info_dict_reader(default_info_dict_reader(list(types), spec=[Unbounded((), dtype=t) for t in types.values()]))
check_env_specs(env)
found = env.rollout(8, break_when_any_done=False)["next"]
assert found["bus_dc_0"].tolist() == [18] * 8
paid = -found["reward"].double().reshape(2, 4).sum(dim=1) / 4
torch.testing.assert_close(found["J"][3::4], paid, rtol=1e-5, atol=0.0)  # J of the episode in its last info

env = GymEnv(NAME, horizon=4).auto_register_info_dict()  # and one that finds all figures by itself
check_env_specs(env)
found = env.rollout(8, break_when_any_done=False)["next"]
assert {"J", "cost_voltage", "voltage_min_pu", "power_flow_converged", "bus_inv_3"} <= set(found.keys())
print("checked")
"""
    assert run("-c", code, home=tmp_path).endswith("checked\n")


@pytest.mark.slow
@needs("torchrl", "tensordict")
def test_torchrl_collectors_and_the_native_batch(tmp_path):
    code = """
import gymnasium, dcgrid_env
from torchrl.collectors import Collector
from torchrl.envs import GymEnv, GymWrapper
from torchrl.envs.utils import check_env_specs
NAME = "dcgrid/IEEE33Weak-v0"

def batch(mode):
    return GymWrapper(gymnasium.make_vec(NAME, num_envs=3, horizon=4, autoreset_mode=mode))

made = {"single": lambda: GymEnv(NAME, horizon=4), "same": lambda: batch("same_step"), "off": lambda: batch("disabled")}
for name, make in made.items():
    check_env_specs(make())
    collector = Collector(make, None, frames_per_batch=24, total_frames=48)
    for data in collector:
        data = data.reshape(-1, data.batch_size[-1])
        ended, now = data["next", "done"].squeeze(-1), data["observation"]
        assert ended.sum(dim=1).tolist() == [ended.shape[1] // 4] * len(ended), name
        goes_on = ~ended[:, :-1]  # each observation is the one that the last action led to, unless an episode begins
        alike = (now[:, 1:] == data["next", "observation"][:, :-1]).all(dim=-1)
        assert alike.equal(goes_on), name
    collector.shutdown()
print("checked")
"""
    assert run("-c", code, home=tmp_path).endswith("checked\n")


@pytest.mark.slow
@needs("torchrl", "tensordict")
def test_torchrl_example(tmp_path):
    options = ["--updates", "1", "--rollout-steps", "120", "--episodes", "2", "--save", "made"]
    options += ["--checkpoint", "results/torchrl.pt"]
    printed = run(EXAMPLES / "torchrl_pettingzoo.py", *options, home=tmp_path)
    check_trained(printed, tmp_path / "made.safetensors")
    assert abs(j_of_the_class("FromTorchRl", tmp_path) - figures(printed)[1]) < 2e-3


@pytest.mark.slow
@needs("ray", "tree")
def test_rllib_wrapper_takes_the_environment_as_it_is(tmp_path):
    code = """
import dcgrid_env
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
for name in ("toy6", "ieee33-weak", "mixed", "fault", "robust"):
    env = ParallelPettingZooEnv(dcgrid_env.parallel_env(name, horizon=4))
    for seed in (0, None):
        observation, _ = env.reset(seed=seed)
        for step in range(4):
            assert set(observation) == set(env.possible_agents), name
            assert env.observation_space.contains(observation), name
            observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
            assert set(reward) == set(env.possible_agents), name
            assert truncated["__all__"] == (step == 3) and not terminated["__all__"], name
    assert env.observation_space.contains(observation) and not env.par_env.agents, name
print("checked")
"""
    assert run("-c", code, home=tmp_path).endswith("checked\n")


@pytest.mark.slow
@needs("ray", "tree")
def test_rllib_on_the_native_batch_has_every_transition_of_every_episode(tmp_path):
    code = """
import numpy as np, dcgrid_env
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner

HORIZON, N_ENV = 12, 3
config = (
    PPOConfig()
    .environment("dcgrid_env:dcgrid/IEEE33Weak-v0", env_config={"horizon": HORIZON, "autoreset_mode": "next_step"})
    .env_runners(
        num_env_runners=0,
        num_envs_per_env_runner=N_ENV,
        gym_env_vectorize_mode="vector_entry_point",
    )
    .training(train_batch_size_per_learner=HORIZON * N_ENV * 2, minibatch_size=HORIZON, num_epochs=1)
    .debugging(seed=7)
)
runner = SingleAgentEnvRunner(config=config)
assert isinstance(runner.env.unwrapped, dcgrid_env.DcgridVectorEnv)
episodes = runner.sample(num_episodes=4 * N_ENV, random_actions=True)
singles = [dcgrid_env.DcgridEnv("ieee33-weak", horizon=HORIZON) for _ in range(N_ENV)]
for i, episode in enumerate(episodes):
    assert len(episode) == HORIZON, len(episode)
    single = singles[i % N_ENV]
    seen, _ = single.reset(seed=runner._seed + i if i < N_ENV else None)
    np.testing.assert_array_equal(episode.get_observations(0), seen)
    for t, action in enumerate(episode.get_actions()):
        seen, reward, *_, info = single.step(action)
        np.testing.assert_array_equal(episode.get_observations(t + 1), seen)
        assert episode.get_rewards(t) == reward
    assert episode.is_truncated and episode.get_infos(-1)["J"] == info["J"]
algorithm = config.build_algo()
found = algorithm.train()["env_runners"]
assert found["episode_len_min"] == found["episode_len_max"] == HORIZON, found
algorithm.stop()
print("checked")
"""
    assert run("-c", code, home=tmp_path).endswith("checked\n")


@pytest.mark.slow
@needs("ray", "tree")
def test_rllib_policy_acts_as_its_modules_do(tmp_path):
    code = """
import sys
sys.path.insert(0, sys.argv[1])
import dcgrid_env, numpy as np, torch
from ray.rllib.algorithms.ppo.torch.default_ppo_torch_rl_module import DefaultPPOTorchRLModule
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from rllib_multi_agent import MODEL, exported

env = dcgrid_env.parallel_env("ieee33-weak")
seen, _ = env.reset(seed=0)
kinds = {"datacenter": "dc_0", "inverter": "inv_0"}
modules = {}
for kind, agent in kinds.items():
    spaces = {"observation_space": env.observation_space(agent), "action_space": env.action_space(agent)}
    modules[kind] = RLModuleSpec(DefaultPPOTorchRLModule, **spaces, model_config=MODEL).build()
policy = exported(modules.get)
policy.reset(env.scenario)
acted = policy.act(seen)
for kind, agent in kinds.items():
    with torch.no_grad():
        out = modules[kind].forward_inference({"obs": torch.as_tensor(seen[agent])[None]})["action_dist_inputs"][0]
    wanted = np.clip(out.numpy()[: len(acted[agent])], -1.0, 1.0)
    assert np.abs(wanted).max() > 1e-3
    np.testing.assert_allclose(acted[agent], wanted, atol=1e-5)
print("checked")
"""
    assert run("-c", code, EXAMPLES, home=tmp_path).endswith("checked\n")


@pytest.mark.slow
@needs("ray", "tree")
def test_rllib_example_with_two_workers(tmp_path):
    options = ["--iterations", "1", "--workers", "2", "--batch", "480", "--episodes", "2", "--save", "made"]
    printed = run(EXAMPLES / "rllib_multi_agent.py", *options, "--checkpoint", "results/rllib", home=tmp_path)
    check_trained(printed, tmp_path / "made.safetensors")
    assert abs(j_of_the_class("FromRllib", tmp_path) - figures(printed)[1]) < 2e-3


@pytest.mark.slow
@needs("torchrl", "tensordict")
def test_torchrl_environment_on_tensors_is_the_pettingzoo_one(tmp_path):
    code = """
import sys
sys.path.insert(0, sys.argv[1])
import dcgrid_env, numpy as np, torch
from torchrl.collectors import Collector
from torchrl.envs.utils import check_env_specs
from torchrl_tensor_env import DcgridTensorEnv

for name in ("toy6", "ieee33-weak", "mixed", "fault"):
    check_env_specs(DcgridTensorEnv(name, num_envs=3, horizon=4))
    batch = DcgridTensorEnv(name, num_envs=3, seed=5, horizon=4)
    data = batch.rollout(8, break_when_any_done=False)
    assert data["next", "done"].squeeze(-1).tolist() == [[False, False, False, True] * 2] * 3
    for env_index, seed in ((0, 5), (2, 7)):  # the first episode of an environment, and 3 seeds later its second
        for first, of in ((0, seed), (4, seed + 3)):
            single = dcgrid_env.parallel_env(name, horizon=4)
            seen, _ = single.reset(seed=of)
            for t in range(first, first + 4):
                acted = {}
                for kind, agents in batch.group_map.items():
                    now = data[kind, "observation"][env_index, t].numpy()
                    np.testing.assert_allclose(now, np.array([seen[a] for a in agents]), atol=2e-4)
                    acted |= dict(zip(agents, data[kind, "action"][env_index, t].numpy()))
                seen, paid, *_ = single.step(acted)
                for kind, agents in batch.group_map.items():
                    given = data["next", kind, "reward"][env_index, t, :, 0].numpy()
                    np.testing.assert_allclose(given, [paid[a] for a in agents], rtol=2e-3)
frames = 0
for data in Collector(lambda: DcgridTensorEnv(num_envs=4, horizon=4), None, frames_per_batch=16, total_frames=48):
    frames += data.numel()
    assert data["next", "done"].sum() == 4
assert frames == 48
print("checked")
"""
    assert run("-c", code, EXAMPLES, home=tmp_path).endswith("checked\n")


@pytest.mark.slow
@needs("benchmarl", extra="benchmarl")
def test_benchmarl_example(tmp_path):
    options = ["--algorithm", "ippo", "--frames", "3840", "--episodes", "2", "--save", "made"]
    printed = run(EXAMPLES / "benchmarl_mappo.py", *options, home=tmp_path)
    check_trained(printed, tmp_path / "made.safetensors")


def check_in_the_table_of_libraries(library, home):
    code = f"""
import json, math, sys
sys.path.insert(0, {str(ROOT)!r})
from docs.studies.commands import main
small = "--scenarios toy6 --seeds 1 --steps 480 --episodes 2 --out made.json"
main(["libraries", "--library", {library!r}, *small.split()])
(record,) = json.loads(open("made.json").read())["trainings"]
assert len(record["J"]) == 2 and all(map(math.isfinite, record["J"])), record
print("checked")
"""
    assert run("-W", "ignore", "-c", code, home=home).endswith("checked\n")


@pytest.mark.slow
@needs("benchmarl", "stable_baselines3", extra="benchmarl,agents")
@pytest.mark.parametrize("algorithm", ["ippo", "mappo"])
def test_benchmarl_in_the_table_of_libraries(algorithm, tmp_path):
    check_in_the_table_of_libraries(f"benchmarl-{algorithm}", tmp_path)


@pytest.mark.slow
@needs("ray", "tree", "stable_baselines3")
def test_rllib_in_the_table_of_libraries(tmp_path):
    check_in_the_table_of_libraries("rllib-ppo", tmp_path)


@pytest.mark.slow
@needs("ray", "tree")
def test_rllib_example_on_the_native_batch_and_its_checkpoint(tmp_path):
    options = ["--runners", "1", "--num-envs", "4", "--episodes", "2"]
    more = ["--iterations", "1", "--save", "made", "--checkpoint", "results/rllib"]
    before, after, _ = figures(run(EXAMPLES / "rllib_native_batch.py", *options, *more, home=tmp_path))
    assert before != after
    assert set(Policy.load(tmp_path / "made.safetensors").networks) == {"joint"}
    again = ["--iterations", "0", "--restore", "results/rllib"]
    assert figures(run(EXAMPLES / "rllib_native_batch.py", *options, *again, home=tmp_path))[0] == after


@pytest.mark.slow
@needs("jax")
def test_a_compiled_scan_in_jax_has_the_costs_of_the_loop(tmp_path):
    code = """
import sys
sys.path.insert(0, sys.argv[1])
import jax, jax.numpy as jnp, numpy as np
from jax_callback import Batch, episode_costs

batch = Batch(3, horizon=6, info="costs")
n, m = batch.sizes
w, b = np.random.default_rng(0).normal(0.0, 0.3, (n, m)).astype(np.float32), np.zeros(m, np.float32)
same = [(jnp.broadcast_to(w, (3, n, m)), jnp.broadcast_to(b, (3, m)))]
found = np.asarray(episode_costs(batch, 6)(same, batch.reset(4)))
observation, _ = batch.envs.reset(seed=4)
for _ in range(6):
    observation, _, _, _, info = batch.envs.step(np.tanh(observation @ w))
assert np.allclose(found, info["final_info"]["J"], rtol=1e-5), (found, info)
print("checked")
"""
    assert run("-c", code, EXAMPLES, home=tmp_path).endswith("checked\n")


@pytest.mark.slow
@needs("jax")
def test_jax_example_shares_memory_and_has_the_derivative_of_the_cost(tmp_path):
    code = """
import sys
sys.path.insert(0, sys.argv[1])
import dcgrid_env, jax, jax.numpy as jnp, numpy as np, torch
jax.config.update("jax_enable_x64", True)
from jax_dlpack import ByJax, episode_cost, to_jax

shared = torch.arange(6.0, dtype=torch.float64).reshape(2, 3)
assert to_jax(shared).unsafe_buffer_pointer() == shared.data_ptr()
env = dcgrid_env.TensorEnv("ieee33-weak", like=torch.empty(0, dtype=torch.float64), horizon=5)
n = env.reset([0]).shape[1]
spaces = dcgrid_env.DcgridEnv("ieee33-weak")
rng = np.random.default_rng(0)
m = spaces.action_space.shape[0]
weights = [(jnp.asarray(rng.normal(0.0, 0.1, (n, m))), jnp.zeros(m))]
gathered = []
episode_cost(env, [0, 1], weights, gathered).backward()
slope = np.asarray(sum(own[0][0] for own in gathered))
i, j = np.unravel_index(np.abs(slope).argmax(), slope.shape)
with torch.no_grad():
    changed = [[(weights[0][0].at[i, j].add(h), weights[0][1])] for h in (1e-5, -1e-5)]
    ends = [float(episode_cost(env, [0, 1], own, [])) for own in changed]
found = (ends[0] - ends[1]) / 2e-5
assert abs(found - slope[i, j]) < 1e-4 * abs(found), (found, slope[i, j])
print("checked")
"""
    assert run("-c", code, EXAMPLES, home=tmp_path).endswith("checked\n")


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("d3rlpy") is None, reason="d3rlpy not installed; see docs/examples/README.md"
)
def test_d3rlpy_example_and_its_policies_without_torch(tmp_path):
    code = """
import sys
sys.path.insert(0, sys.argv[1])
import numpy as np
import offline_d3rlpy as example
from dcgrid_env.agents import Policy
from dcgrid_env.cli.main import main as dcgrid

dcgrid("dataset --controller droop,random --noise 0.1 --episodes 4 --set reward=difference horizon=12".split())
name = "dcgrid/ieee33-weak/droop-and-random-noise-0_1-v0"
models = []
exported = example.exported
example.exported = lambda model: models.append(model) or exported(model)
small = {"steps": 3, "batch": 8, "episodes": 2}
data = example.Data(name, "difference")
for algorithm in ("bc", "cql", "iql", "td3-bc"):
    example.main(name, algorithm, "team", **small)
    example.main(name, algorithm, save=example.Path("made"), **small)
    policy = Policy.load("made.safetensors")
    for kind, model in zip(data.agents, models[-2:], strict=True):
        seen = data.of_kind(kind).episodes[0].observations
        np.testing.assert_allclose(policy.networks[kind](seen), model.predict(seen), atol=1e-5)
dcgrid("dataset --controller droop --episodes 1 --set horizon=12 --name plain".split())
try:
    example.main("dcgrid/ieee33-weak/plain-v0", **small)
except ValueError as error:
    print(error)
"""
    printed = run("-c", code, EXAMPLES, home=tmp_path)
    assert "has no difference rewards; write it with --set reward=difference" in printed.splitlines()[-1]
