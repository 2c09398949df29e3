"""What libraries are trained on, and how their policies are selected on validation and tested."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from runpy import run_path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dcgrid_env import make_scenario
from dcgrid_env.agents import RowPolicy
from dcgrid_env.baselines import rollout

if TYPE_CHECKING:
    from torch import nn

DISCOUNTS = {"difference": 0.0, "local": 0.9, "shared": 0.9}
"""Discount for each reward and second. A difference reward charges later costs at once."""
VALIDATION_EPISODES, EVALUATIONS = 16, 4
OFF_POLICY_BATCH = 256
"""Rows of a batch of SAC, TD3 and MADDPG: for many updates in a short training."""


def example(name: str) -> SimpleNamespace:
    """Run a script of docs/examples and return its contents."""
    return SimpleNamespace(**run_path(str(Path(__file__).parents[2] / "examples" / f"{name}.py")))


class Setting(NamedTuple):
    """What to train on."""

    scenario: str
    reward: str
    seed: int
    steps: int
    """Decisions in all environments of the batch together. A decision is a step, except for power smoothing."""
    num_envs: int
    episodes: int
    """Number of test episodes."""


class Outcome(NamedTuple):
    """Results of the best policy of a training."""

    validation: float
    """Mean J of the validation episodes."""
    J: np.ndarray
    """J of each test episode, (episode,)."""


class BestOnValidation:
    """Keep the parameters of the policy with the lowest mean J on validation.

    Parameters
    ----------
    network
        Network that is trained.
    begin
        Begins episodes: returns a function from observations of rows to the network's actions, see :class:`RowPolicy`.
    on
        What is trained.
    """

    def __init__(self, network: nn.Module, begin: Callable[[], Callable[[np.ndarray], Any]], on: Setting):
        self.network, self.begin, self.on, self.best, self._due = network, begin, on, np.inf, 0.0

    def evaluate(self, share: float) -> None:
        """Evaluate the network after a share of the training, unless it is too soon."""
        if share < self._due:
            return
        self._due = share + 1.0 / EVALUATIONS
        j = float(self._costs("validation", VALIDATION_EPISODES).mean())
        if j < self.best:
            self.best, self._kept = j, copy.deepcopy(self.network.state_dict())

    def tested(self) -> Outcome:
        """Evaluate once more, and return the results of the best network; it has those parameters from then on."""
        self._due = 0.0
        self.evaluate(1.0)
        self.network.load_state_dict(self._kept)
        return Outcome(self.best, self._costs("test", self.on.episodes))

    def _costs(self, split: str, episodes: int) -> np.ndarray:
        scenario = make_scenario(self.on.scenario, split=split)
        return rollout(scenario, RowPolicy(self.begin()), range(episodes)).costs()
