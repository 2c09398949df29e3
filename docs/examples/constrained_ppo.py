"""Constrained learning: an unmodified PPO of Stable-Baselines3 with a budget for voltage violations in each episode.

The budget limits the mean of ``info["cost"]`` over the steps of an episode: the weighted voltage violation and other
limits that have a weight. The return is the reward without this cost, ``reward + info["cost"]``. Two wrappers of the
VecEnv change the reward, and PPO does not know about the constraint:

- Lagrangian (J. Achiam and D. Amodei, "Benchmarking safe exploration in deep reinforcement learning", 2019): the reward
  is (return - multiplier * cost) / (1 + multiplier). After each rollout the multiplier increases if the mean cost of an
  episode is above the budget and decreases if it is below. The constraint holds on average over episodes.
- Saute (A. Sootla et al., "Saute RL: almost surely safe reinforcement learning using state augmentation", ICML 2022):
  the remaining share of the budget is observed. Once it is negative, each step has a fixed penalty as its reward. The
  constraint is for every episode.

    python docs/examples/constrained_ppo.py --method lagrangian --budget 0.02
"""

from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
import tyro
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnvWrapper, VecNormalize

from dcgrid_env import end_costs, info_arrays, make_scenario
from dcgrid_env.agents import find_controller, sb3_vec_env
from dcgrid_env.baselines import rollout

Method = Literal["lagrangian", "saute", "none"]


class Constrained(VecEnvWrapper):
    """Separate the cost of the constraint from the reward, and sum both over the episodes.

    The reward pays the costs of the episode's end, such as work that is left, as they arise.

    Parameters
    ----------
    envs
        Rows of ``sb3_vec_env`` with the shared reward.
    """

    def __init__(self, envs: Any):
        super().__init__(envs)
        self.rows, n_envs = envs, envs.num_envs // envs.rows_per_env
        self.horizon: int = envs.scenario.horizon
        self.sums = np.zeros((n_envs, 2))
        self.ended: list[tuple[float, float]] = []
        """Return and cost of each episode that has ended, both means over the horizon."""

    def reset(self) -> Any:
        """Begin episodes."""
        self.sums[:] = 0.0
        first = self.venv.reset()
        self.due = self.due_at_rest = self.end_costs()
        return self.observed(first)

    def end_costs(self) -> np.ndarray:
        """Return what the end of the episodes would charge after the last step, (env,)."""
        due = end_costs(self.rows.scenario, self.rows.batch.transition.state)
        return sum(due.values(), np.zeros(len(self.sums)))

    def step_wait(self) -> Any:
        """Return observation, reward, done and infos with ``cost`` of the row's environment."""
        observation, reward, done, infos = self.venv.step_wait()
        each = self.rows.rows_per_env
        cost = info_arrays(self.rows.scenario, self.rows.batch.transition, "costs")["cost"]
        due, over = self.end_costs(), done[::each]
        free = reward[::each] + cost + self.due - due + due * self.rows.truncated[::each]
        self.due = np.where(over, self.due_at_rest, due)  # every episode begins at rest
        self.sums += np.stack([free, cost], axis=1)
        paid = np.repeat(self.paid(free, cost), each).astype(np.float32)
        for row, info in enumerate(infos):
            info["cost"] = float(cost[row // each])
        arrived = {row: infos[row]["terminal_observation"] for row in np.flatnonzero(done).tolist()}
        for row, last in arrived.items():
            infos[row]["terminal_observation"] = self.observed(last, row)
        self.ended += [(free_sum / self.horizon, cost_sum / self.horizon) for free_sum, cost_sum in self.sums[over]]
        self.sums[over] = 0.0
        return self.observed(observation), paid, done, infos

    def observed(self, observation: Any, row: int | None = None) -> np.ndarray:
        """Return what the policy observes in all rows, or in one."""
        return observation

    def paid(self, free: np.ndarray, cost: np.ndarray) -> np.ndarray:
        """Return the reward of each environment from its reward without the cost and its cost, (env,) each."""
        return free - cost


class Lagrangian(Constrained):
    """Charge the cost at the price ``multiplier``."""

    multiplier = 1.0

    def paid(self, free: np.ndarray, cost: np.ndarray) -> np.ndarray:
        """Return the reward of each environment."""
        return (free - self.multiplier * cost) / (1.0 + self.multiplier)


class Saute(Constrained):
    """Observe the remaining share of the budget, and pay ``-penalty`` once it is negative.

    Parameters
    ----------
    envs
        See :class:`Constrained`.
    budget
        Largest mean cost over the steps of an episode.
    penalty
        Cost of a step after the budget is spent; above any usual cost of a step.
    """

    def __init__(self, envs: Any, budget: float, penalty: float):
        super().__init__(envs)
        self.budget, self.penalty = budget, penalty
        space = envs.observation_space
        low, high = np.append(space.low, -np.inf), np.append(space.high, 1.0)
        self.observation_space = spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)

    @property
    def left(self) -> np.ndarray:
        """Remaining share of each environment's budget, at least -1, (env,)."""
        return np.maximum(1.0 - self.sums[:, 1] / (self.horizon * self.budget), -1.0)

    def observed(self, observation: Any, row: int | None = None) -> np.ndarray:
        """Return the observation with the remaining share."""
        if row is not None:
            return np.append(observation, self.left[row // self.rows.rows_per_env]).astype(np.float32)
        left = np.repeat(self.left, self.rows.rows_per_env)
        return np.concatenate([observation, left[:, None]], axis=1).astype(np.float32)

    def paid(self, free: np.ndarray, cost: np.ndarray) -> np.ndarray:
        """Return the reward of each environment."""
        return np.where(self.left < 0.0, -self.penalty, free)


class MultiplierUpdate(BaseCallback):
    """Update the multiplier after each rollout by the mean cost of the episodes that ended in it.

    Parameters
    ----------
    envs
        Rows with a multiplier.
    budget
        Largest mean cost over the steps of an episode.
    rate
        Change of the logarithm of the multiplier for a cost of twice the budget.
    """

    def __init__(self, envs: Lagrangian, budget: float, rate: float):
        super().__init__()
        self.envs, self.budget, self.rate = envs, budget, rate

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        if self.envs.ended:
            excess = float(np.mean([cost for _, cost in self.envs.ended])) / self.budget - 1.0
            change = self.rate * np.clip(excess, -1.0, 1.0)
            self.envs.multiplier = float(np.clip(self.envs.multiplier * np.exp(change), 0.01, 1000.0))
            self.envs.ended.clear()


class Result(NamedTuple):
    """Means over episodes."""

    free: float
    """Mean reward of a step without the cost of the constraint."""
    cost: float
    """Mean cost of the constraint of a step."""
    over: float
    """Share of the episodes whose mean cost is above the budget."""


def result(episodes: np.ndarray, budget: float) -> Result:
    """Return the means of returns and costs, (episode, 2)."""
    free, cost = episodes.mean(axis=0).tolist()
    return Result(free, cost, float((episodes[:, 1] > budget).mean()))


def of_controller(name: str, scenario: str, episodes: int, budget: float) -> Result:
    """Evaluate a controller on test episodes."""
    test = make_scenario(scenario, split="test")
    metrics = rollout(test, find_controller(name, test), range(episodes)).metrics()
    costs = np.array([metric["cost_violation"] for metric in metrics])
    return result(np.stack([costs - np.array([metric["J"] for metric in metrics]), costs], axis=1), budget)


def main(
    scenario: str = "ieee33-weak",
    method: Method = "lagrangian",
    budget: float = 0.02,
    steps: int = 200_000,
    num_envs: int = 32,
    rate: float = 0.1,
    penalty: float = 10.0,
    gamma: float = 0.97,
    learning_rate: float = 3e-3,
    log_std: float = -1.0,
    episodes: int = 100,
    seed: int = 0,
    compare: tuple[str, ...] = ("droop-tuned",),
    save: Path | None = None,
) -> Result:
    """Train with a budget, and return the result on test episodes.

    Parameters
    ----------
    scenario
        Name of a preset whose constraint is the voltage violation.
    method
        "lagrangian", "saute", or "none" (the ordinary reward).
    budget
        Largest mean cost over the steps of an episode.
    steps
        Environment steps of the training.
    num_envs
        Environments in the batch.
    rate
        Learning rate of the multiplier (lagrangian).
    penalty
        Cost of a step after the budget is spent (saute).
    gamma
        Discount factor.
    learning_rate
        Initial learning rate; it decays to zero.
    log_std
        Logarithm of the initial standard deviation of exploration.
    episodes
        Test episodes.
    seed
        Random seed.
    compare
        Controllers and policies to evaluate on the same episodes.
    save
        File for the policy; VecNormalize is saved next to it.
    """
    if not budget > 0.0:
        raise ValueError(f"budget: must be positive, got {budget}; the tuned droop's mean cost is a start")
    torch.set_num_threads(1)  # more threads slow down networks of this size

    def constrained(split: str, n: int) -> Constrained:
        rows = sb3_vec_env(scenario, n, view="shared", outputs="droop", nameplate=True, reward="shared", split=split)
        if method == "saute":
            return Saute(rows, budget, penalty)
        return Lagrangian(rows) if method == "lagrangian" else Constrained(rows)

    training = constrained("train", num_envs)
    envs = VecNormalize(training, gamma=gamma)
    envs.seed(seed * num_envs)
    rows = training.horizon * envs.num_envs
    ppo: dict[str, Any] = {"gamma": gamma, "gae_lambda": 0.8, "n_steps": training.horizon, "batch_size": -(-rows // 8)}
    ppo |= {"n_epochs": 3, "learning_rate": lambda left: learning_rate * left}
    model = PPO("MlpPolicy", envs, seed=seed, device="cpu", policy_kwargs={"log_std_init": log_std}, **ppo)
    update = MultiplierUpdate(training, budget, rate) if isinstance(training, Lagrangian) else None
    model.learn(steps * training.rows.rows_per_env, update)
    testing = constrained("test", episodes)
    tested = VecNormalize(testing, training=False, norm_reward=False)
    tested.obs_rms = envs.obs_rms
    tested.seed(0)
    observations: Any = tested.reset()
    done = np.zeros(1, bool)
    while not done.all():
        actions, _ = model.predict(observations, deterministic=True)
        observations, _, done, _ = tested.step(actions)
    found = result(np.array(testing.ended), budget)
    compared = {name: of_controller(name, scenario, episodes, budget) for name in compare}
    for name, figures in (compared | {method: found}).items():
        print(f"{name}: return {figures.free:.3f}, cost {figures.cost:.4f}, {figures.over:.2f} of episodes over budget")
    if save:
        save.parent.mkdir(parents=True, exist_ok=True)
        model.save(save)
        envs.save(str(save.with_suffix(".pkl")))
    return found


if __name__ == "__main__":
    tyro.cli(main)
