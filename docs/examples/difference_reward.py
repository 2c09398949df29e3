"""Train an unmodified PPO of Stable-Baselines3 with difference rewards, and compare it with the tuned droop.

``reward="difference"`` pays each channel of an agent for the cost that its own action saves in the step. The credit
assignment is then solved by the environment, so the discount is 0. The reward uses the feeder's model in training; the
policy acts on local observations only.

    python docs/examples/difference_reward.py --scenario ieee33-weak
"""

from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
import tyro
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize

import dcgrid_env
from dcgrid_env.agents import sb3_vec_env
from dcgrid_env.baselines import make_controller, rollout


def costs(model: Any, envs: VecNormalize) -> np.ndarray:
    """J of one episode in each environment of a batch, with the means of the policy as actions, (env,)."""
    made: Any = envs.venv
    envs.seed(0)
    observations, done, state = envs.reset(), np.ones(envs.num_envs, bool), None
    j = np.full(envs.num_envs, np.nan)
    while np.isnan(j).any():
        actions, state = model.predict(observations, state, episode_start=done, deterministic=True)
        observations, _, done, infos = envs.step(actions)
        for row in np.flatnonzero(done & np.isnan(j)):  # a collapse ends an episode early
            j[row] = infos[row]["J"]
    return j[:: made.rows_per_env]


class BestOnValidation(BaseCallback):
    """Keep the parameters of the policy with the lowest mean J on validation, and the observations' mean and variance.

    Parameters
    ----------
    envs
        Validation environments.
    every
        Steps of all rows between evaluations.
    """

    def __init__(self, envs: VecNormalize, every: int):
        super().__init__()
        self.envs, self.every, self.due, self.best = envs, every, 0, np.inf
        self.kept: Any = None

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if self.num_timesteps >= self.due:
            self.due += self.every
            self.evaluate()

    def _on_training_end(self) -> None:
        self.evaluate()
        self.model.policy.load_state_dict(self.kept[0])
        self.envs.obs_rms = self.kept[1]

    def evaluate(self) -> None:
        """Evaluate the policy as it is now."""
        trained: Any = self.model.get_env()
        self.envs.obs_rms = trained.obs_rms.copy()
        j = costs(self.model, self.envs).mean()
        if j < self.best:
            state = {name: values.clone() for name, values in self.model.policy.state_dict().items()}
            self.best, self.kept = j, (state, self.envs.obs_rms)


def main(
    scenario: str = "ieee33-weak",
    outputs: Literal["change", "droop"] = "droop",
    steps: int = 200_000,
    num_envs: int = 32,
    learning_rate: float = 3e-3,
    log_std: float = -1.0,
    episodes: int = 50,
    seed: int = 0,
    save: Path | None = None,
) -> tuple[float, float]:
    """Train, select on validation, and return the mean J of test episodes of the policy and of the tuned droop.

    Parameters
    ----------
    scenario
        Name of a preset.
    outputs
        "change": actions are changes of reactive power. "droop": actions are corrections of the tuned droop.
    steps
        Environment steps of the training.
    num_envs
        Environments in the batch.
    learning_rate
        Initial learning rate; it decays to zero.
    log_std
        Logarithm of the initial standard deviation of exploration.
    episodes
        Test episodes.
    seed
        Random seed.
    save
        File for the policy; VecNormalize is saved next to it.
    """
    torch.set_num_threads(1)  # more threads slow down networks of this size
    common: dict[str, Any] = {"view": "channel", "outputs": outputs, "nameplate": True}
    default = "droop" if outputs == "droop" else "previous"  # what an action of 0 does
    made = sb3_vec_env(scenario, num_envs, reward="difference", cost={"default_action": default}, **common)
    envs = VecNormalize(made, gamma=0.0)
    envs.seed(seed * num_envs)
    horizon = made.scenario.horizon
    ppo: dict[str, Any] = {"gamma": 0.0, "gae_lambda": 0.0, "n_steps": horizon, "n_epochs": 3}
    ppo |= {"batch_size": -(-horizon * made.num_envs // 8), "learning_rate": lambda left: learning_rate * left}
    model = PPO("MlpPolicy", envs, seed=seed, device="cpu", policy_kwargs={"log_std_init": log_std}, **ppo)
    held_out = VecNormalize(sb3_vec_env(scenario, 32, split="validation", **common), training=False, norm_reward=False)
    steps *= made.rows_per_env
    best = BestOnValidation(held_out, every=steps // 15)
    model.learn(steps, best)
    tested = VecNormalize(sb3_vec_env(scenario, episodes, split="test", **common), training=False, norm_reward=False)
    envs.obs_rms = tested.obs_rms = held_out.obs_rms
    after = float(costs(model, tested).mean())
    test = dcgrid_env.make_scenario(scenario, split="test")
    droop = float(rollout(test, make_controller("droop-tuned", test), range(episodes)).costs().mean())
    print(f"mean J on validation {best.best:.4f}, of {episodes} test episodes {after:.4f}, tuned droop {droop:.4f}")
    if save:
        save.parent.mkdir(parents=True, exist_ok=True)
        model.save(save)
        envs.save(str(save.with_suffix(".pkl")))
    return after, droop


if __name__ == "__main__":
    tyro.cli(main)
