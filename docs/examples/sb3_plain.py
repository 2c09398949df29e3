"""Stable-Baselines3 as it comes, on the Gymnasium id: one PPO policy holds all actuators of the feeder.

``gymnasium.make(id)`` is all that SB3 needs; ``make_vec_env`` makes several. They are separate environments, stepped
one after the other: cleanrl_ppo.py steps a native batch instead, many times faster.

    python docs/examples/sb3_plain.py --steps 40000 --save results/sb3_plain.zip
"""

from pathlib import Path
from typing import Any

import tyro
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

import dcgrid_env
from dcgrid_env.baselines import make_controller, rollout


class Trained:
    """An SB3 model as dcgrid's controller: the joint observation in, the joint action out, for any batch size."""

    def __init__(self, model: PPO):
        self.model = model

    def reset(self, env_info: dcgrid_env.Scenario) -> None:
        """Nothing is remembered from step to step."""

    def act(self, observations: Any) -> Any:
        """Mean of the policy's distribution, cut to the range of actions."""
        return self.model.predict(observations, deterministic=True)[0]


def main(
    steps: int = 40_000, num_envs: int = 4, episodes: int = 20, seed: int = 0, save: Path | None = None
) -> tuple[float, float]:
    """Train, and give the mean J of validation episodes before and after."""
    validation = dcgrid_env.make_scenario("ieee123", split="validation")
    envs = make_vec_env("dcgrid/IEEE123-v0", n_envs=num_envs, seed=seed)
    # What an action costs is charged within a few steps, so a short horizon learns fastest.
    ppo = {"gamma": 0.5, "n_steps": 256, "policy_kwargs": {"log_std_init": -1.0}}
    model = PPO("MlpPolicy", envs, seed=seed, device="cpu", **ppo)
    before = float(rollout(validation, Trained(model), range(episodes)).costs().mean())
    model.learn(steps)
    after = float(rollout(validation, Trained(model), range(episodes)).costs().mean())
    droop = rollout(validation, make_controller("droop-tuned", validation), range(episodes)).costs().mean()
    print(f"mean J of {episodes} validation episodes: {before:.3f} before, {after:.3f} after, tuned droop {droop:.3f}")
    if save:
        save.parent.mkdir(parents=True, exist_ok=True)
        model.save(save)
    return before, after


if __name__ == "__main__":
    tyro.cli(main)
