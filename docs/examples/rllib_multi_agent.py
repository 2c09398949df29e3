"""RLlib on the PettingZoo environment: PPO with one policy for all data centres and one for all inverters.

RLlib's ``ParallelPettingZooEnv`` takes ``dcgrid_env.parallel_env`` as it is. Two workers (env runners) collect episodes
in processes of their own, this one learns.

    python docs/examples/rllib_multi_agent.py --iterations 3 --workers 2

On a Ray cluster it is the same script, with ``pip install -e '.[frameworks]'`` in a clone of the
repository on every node:

    ray start --head                                        # on one node
    ray start --address HEAD:6379                           # on each other node
    python docs/examples/rllib_multi_agent.py --address auto --workers 64 --batch 61440

``--address auto`` joins the running cluster (``ray.init(address="auto")``) instead of starting one here, and Ray places
the env runners where CPUs are free. Give the batch some 960 steps, 8 episodes, for each. Where Ray asks for a token,
all nodes need the same one (``ray get-auth-token``).
"""

from pathlib import Path

import ray
import torch
import tyro
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from ray.tune.registry import register_env

import dcgrid_env
from dcgrid_env.agents import Network, Policy
from dcgrid_env.baselines import make_controller, rollout

SCENARIO = "ieee33-weak"
MODEL = DefaultModelConfig(fcnet_hiddens=[64, 64], fcnet_activation="tanh", vf_share_layers=False, free_log_std=True)


def exported(get_module) -> Policy:
    """The two policies' means as NumPy arrays, which dcgrid drives, saves and benchmarks without Ray."""
    networks = {}
    for kind in ("datacenter", "inverter"):
        module = get_module(kind)
        parts = (*module.encoder.actor_encoder.modules(), *module.pi.modules())
        linear = [layer for layer in parts if isinstance(layer, torch.nn.Linear)]
        arrays = [(layer.weight.detach().numpy().T.copy(), layer.bias.detach().numpy().copy()) for layer in linear]
        networks[kind] = Network(arrays, activation="tanh", squash="clip")
    return Policy(networks, scenario=SCENARIO)


def main(
    iterations: int = 3,
    workers: int = 2,
    batch: int = 1920,
    episodes: int = 20,
    seed: int = 0,
    reward: str = "local",
    address: str = "local",
    save: Path | None = None,
    checkpoint: Path | None = None,
) -> tuple[float, float]:
    """Train, and give the mean J of validation episodes before and after."""
    # The head of a cluster knows its CPUs; here each worker is given one, however many there are.
    here = {"num_cpus": max(workers, 1), "include_dashboard": False} if address == "local" else {}
    ray.init(address, **here)
    register_env("dcgrid", lambda _: ParallelPettingZooEnv(dcgrid_env.parallel_env(SCENARIO, reward=reward)))
    config = (
        PPOConfig()
        .environment("dcgrid")
        .env_runners(num_env_runners=workers, batch_mode="complete_episodes")
        .multi_agent(
            policies={"datacenter", "inverter"},
            policy_mapping_fn=lambda agent, *_, **__: "datacenter" if agent.startswith("dc_") else "inverter",
        )
        .rl_module(model_config=MODEL)
        .training(gamma=0.5, lr=1e-3, train_batch_size_per_learner=batch, minibatch_size=min(batch, 512), num_epochs=4)
        .debugging(seed=seed, log_level="ERROR")
    )
    algorithm = config.build_algo()
    validation = dcgrid_env.make_scenario(SCENARIO, split="validation")
    before = float(rollout(validation, exported(algorithm.get_module), range(episodes)).costs().mean())
    for _ in range(iterations):
        algorithm.train()
    policy = exported(algorithm.get_module)
    after = float(rollout(validation, policy, range(episodes)).costs().mean())
    if checkpoint:
        algorithm.save_to_path(checkpoint.absolute())
    algorithm.stop()
    ray.shutdown()
    droop = rollout(validation, make_controller("droop-tuned", validation), range(episodes)).costs().mean()
    print(f"mean J of {episodes} validation episodes: {before:.3f} before, {after:.3f} after, tuned droop {droop:.3f}")
    if save:
        policy.save(save)
    return before, after


if __name__ == "__main__":
    tyro.cli(main)
