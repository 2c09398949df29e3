"""RLlib on the native batch: PPO with one policy for all devices, several env runners, many environments each.

Each env runner is a process. It makes one ``DcgridVectorEnv`` and steps all its environments at once
(``gym_env_vectorize_mode="vector_entry_point"``). RLlib expects ``autoreset_mode="next_step"``: with another mode it
loses the first transition of each episode without a message.

    python docs/examples/rllib_native_batch.py --runners 2 --num-envs 32 --save results/rllib

``--address auto`` joins a running cluster, where Ray places the env runners on whatever nodes have CPUs free; each
needs ``pip install -e '.[frameworks]'`` in a clone of the repository. ``--restore`` goes on from what ``--checkpoint``
wrote.
"""

from pathlib import Path

import ray
import torch
import tyro
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig

import dcgrid_env
from dcgrid_env.agents import Network, Policy
from dcgrid_env.baselines import make_controller, rollout

SCENARIO, NAME = "ieee33-weak", "dcgrid_env:dcgrid/IEEE33Weak-v0"
MODEL = DefaultModelConfig(fcnet_hiddens=[64, 64], fcnet_activation="tanh", vf_share_layers=False, free_log_std=True)


def exported(module) -> Policy:
    """The mean action as a centralised policy of NumPy arrays, which dcgrid drives, saves and scores without Ray."""
    parts = (*module.encoder.actor_encoder.modules(), *module.pi.modules())
    linear = [layer for layer in parts if isinstance(layer, torch.nn.Linear)]
    arrays = [(layer.weight.detach().numpy().T.copy(), layer.bias.detach().numpy().copy()) for layer in linear]
    return Policy({"joint": Network(arrays, activation="tanh", squash="clip")}, scenario=SCENARIO)


def main(
    iterations: int = 12,
    runners: int = 2,
    num_envs: int = 32,
    learning_rate: float = 1e-3,
    episodes: int = 20,
    seed: int = 0,
    address: str = "local",
    save: Path | None = None,
    checkpoint: Path | None = None,
    restore: Path | None = None,
) -> tuple[float, float]:
    """Train, and give the mean J of validation episodes before and after."""
    here = {"num_cpus": max(runners, 1), "include_dashboard": False} if address == "local" else {}
    ray.init(address, **here)
    batch = max(runners, 1) * num_envs * dcgrid_env.make_scenario(SCENARIO).horizon
    config = (
        PPOConfig()
        .environment(NAME, env_config={"autoreset_mode": "next_step", "info": "none"})
        .env_runners(
            num_env_runners=runners,
            num_envs_per_env_runner=num_envs,
            gym_env_vectorize_mode="vector_entry_point",
            batch_mode="complete_episodes",
        )
        .rl_module(model_config=MODEL)
        .training(
            gamma=0.5, lr=learning_rate, train_batch_size_per_learner=batch, minibatch_size=batch // 8, num_epochs=4
        )
        .debugging(seed=seed, log_level="ERROR")
    )
    algorithm = config.build_algo()
    if restore:
        algorithm.restore_from_path(restore.absolute())
    validation = dcgrid_env.make_scenario(SCENARIO, split="validation")
    before = float(rollout(validation, exported(algorithm.get_module()), range(episodes)).costs().mean())
    for _ in range(iterations):
        algorithm.train()
    policy = exported(algorithm.get_module())
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
