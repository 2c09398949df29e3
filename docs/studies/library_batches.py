"""Environments on which libraries are trained, validated and tested; every row is a channel of an agent."""

from __future__ import annotations

from pathlib import Path
from runpy import run_path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

from dcgrid_env.agents import sb3_vec_env

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecNormalize

CORRECTED = ("ieee33-weak",)
"""Scenarios in which actions correct the tuned droop; elsewhere they are changes of reactive power."""
DISCOUNTS = {"difference": 0.0, "shared": 0.5}
"""Discount for each reward. A difference reward charges later costs at once."""
VALIDATION_EPISODES, EVALUATIONS = 32, 15


def example(name: str) -> SimpleNamespace:
    """Run a script of docs/examples and return its contents."""
    return SimpleNamespace(**run_path(str(Path(__file__).parents[1] / "examples" / f"{name}.py")))


class Setting(NamedTuple):
    """What to train on."""

    scenario: str
    reward: str
    seed: int
    steps: int
    """Steps of all environments of the batch together."""
    num_envs: int
    episodes: int
    """Number of test episodes."""


class Batches(NamedTuple):
    """Batches with normalised observations; those of the training have normalised rewards too."""

    train: VecNormalize
    validation: VecNormalize
    test: VecNormalize

    @property
    def sizes(self) -> tuple[int, int]:
        """Lengths of an observation and an action of a row."""
        observations, actions = (space.shape for space in (self.train.observation_space, self.train.action_space))
        assert observations is not None
        assert actions is not None
        return observations[0], actions[0]


def batches(on: Setting) -> Batches:
    """Make the environments of a training."""
    from stable_baselines3.common.vec_env import VecNormalize

    outputs, default = ("droop", "droop") if on.scenario in CORRECTED else ("change", "previous")
    rows: dict[str, Any] = {"view": "channel", "outputs": outputs, "nameplate": True}
    cost = {"default_action": default} if on.reward == "difference" else {}
    made = sb3_vec_env(on.scenario, on.num_envs, reward=on.reward, cost=cost, **rows)
    train = VecNormalize(made, gamma=DISCOUNTS[on.reward])
    train.seed(on.seed * on.num_envs)
    held_out = (
        VecNormalize(sb3_vec_env(on.scenario, n, split=split, **rows), training=False, norm_reward=False)
        for n, split in ((VALIDATION_EPISODES, "validation"), (on.episodes, "test"))
    )
    return Batches(train, *held_out)
