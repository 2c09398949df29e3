"""A Stable-Baselines3 model driven by SB3 itself. Loading it unpickles it, which runs whatever code it holds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import stable_baselines3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.save_util import load_from_pkl
from stable_baselines3.common.vec_env import VecNormalize

from dcgrid_env import Scenario
from dcgrid_env.agents.from_sb3.sb3_policy import BEHIND_VEC_NORMALIZE, Normalisation, rows_for
from dcgrid_env.agents.from_sb3.sb3_zip import algorithm_of, read_about
from dcgrid_env.agents.policy.neural_network import PolicyError
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.row_policy import RowPolicy
from dcgrid_env.agents.training.row_form import RowActions, RowForm
from dcgrid_env.agents.training.row_views import Rows
from dcgrid_env.baselines import rollout
from dcgrid_env.baselines.user_code import OwnCodeError, described

TOLERANCE = 1e-4
"""Largest difference between an action of an exported policy and SB3's, of a range of 2: the rounding of float32."""
EPISODES = 4
"""Episodes of the training split over which the two are compared."""


class Sb3Controller(RowPolicy):
    """A model of Stable-Baselines3 as a controller: the actions are those of ``predict(deterministic=True)``.

    Parameters
    ----------
    model
        Model of an algorithm without memory.
    normalisation
        That of the VecNormalize which it was trained behind.
    called
        Name of the model in errors.

    Raises
    ------
    PolicyError
        If the model is recurrent.
    """

    def __init__(self, model: BaseAlgorithm, normalisation: Normalisation | None = None, called: str = "model"):
        super().__init__(self._predicted)
        self.model, self.normalisation, self.called = model, normalisation, called
        if hasattr(model.policy, "lstm_actor"):
            raise PolicyError(
                f"{called}: it is recurrent; write a controller class with its state (docs/own-policy.md)"
            )

    def _rows_on(self, scenario: Scenario) -> Rows:
        """Return the rows of the model's spaces; raise PolicyError if they are not of the scenario."""
        space = self.model.action_space
        shapes: tuple[Any, ...] = (self.model.observation_space.shape, space.shape)
        if any(shape is None or len(shape) != 1 for shape in shapes):
            raise PolicyError(f"{self.called}: spaces have the shapes {shapes}; a model for dcgrid has flat ones")
        form = RowForm.read(space.form) if isinstance(space, RowActions) else None
        return rows_for(scenario, (shapes[0][0], shapes[1][0]), form)

    def _predicted(self, rows: np.ndarray) -> np.ndarray:
        if self.normalisation is not None:
            mean, std, clip = self.normalisation
            rows = np.clip((rows - mean) / std, -clip, clip).astype(np.float32)
        return self.model.predict(rows, deterministic=True)[0]


def of_model(model: BaseAlgorithm) -> Sb3Controller:
    """Return the controller of a model in memory, with the VecNormalize around its environment, if any."""
    envs = model.get_vec_normalize_env()
    return Sb3Controller(model, None if envs is None else Normalisation.from_envs(envs))


def loaded(path: Path, normalisation: Normalisation | None = None) -> Sb3Controller:
    """Return the controller of a zip that ``model.save`` wrote. The zip is unpickled.

    Raises PolicyError if the file is not such a zip or the algorithm is unknown, and OwnCodeError if Stable-Baselines3
    cannot load it.
    """
    try:
        algorithm = getattr(stable_baselines3, algorithm_of(read_about(path)).upper())
    except PolicyError as error:
        raise PolicyError(f"{path}: {error}") from None
    try:
        model = algorithm.load(path, device="cpu", custom_objects={"buffer_size": 1})
    except Exception as error:  # whatever the pickles run
        raise OwnCodeError(f"{path}: Stable-Baselines3 cannot load it: {described(error)}") from error
    return Sb3Controller(model, normalisation, str(path))


def trusted(path: Path) -> Sb3Controller:
    """Return a controller that runs a model unchanged.

    Raises PolicyError if it was trained behind VecNormalize, without whose statistics its actions are meaningless.
    """
    controller = loaded(path)
    about = read_about(path)
    if "gae_lambda" in about and about.get("_last_original_obs") is not None:
        raise PolicyError(f"{path}: {BEHIND_VEC_NORMALIZE}")
    return controller


def read_normalisation(path: Path) -> Normalisation | None:
    """What a file of ``VecNormalize.save`` does to observations; None where it leaves them. The file is unpickled.

    PolicyError for a file of something else, OwnCodeError where it cannot be unpickled.
    """
    try:
        found = load_from_pkl(path)
    except OSError:
        raise
    except Exception as error:  # whatever the pickle runs
        raise OwnCodeError(f"{path}: it cannot be unpickled: {described(error)}") from error
    if not isinstance(found, VecNormalize):
        raise PolicyError(f"{path}: holds a {type(found).__name__}; give the file that VecNormalize.save wrote")
    return Normalisation.from_envs(found)


class _Compared:
    """Drives as SB3 does, and keeps the largest difference from a policy's action."""

    def __init__(self, controller: Sb3Controller, policy: Policy):
        self._controller, self._policy, self.largest = controller, policy, 0.0
        self.observe = policy.observe

    def reset(self, env_info: Scenario) -> None:
        self._controller.reset(env_info)
        self._policy.reset(env_info)

    def act(self, observations: np.ndarray) -> np.ndarray:
        action = self._controller.act(observations)
        self.largest = max(self.largest, float(np.abs(action - self._policy.act(observations)).max()))
        return action


def largest_difference(controller: Sb3Controller, policy: Policy, scenario: Scenario) -> float:
    """The largest difference between SB3's actions and a policy's over ``EPISODES`` that SB3 drives.

    PolicyError where it is above ``TOLERANCE``: the zip then holds something else than it says.
    """
    compared = _Compared(controller, policy)
    rollout(scenario, compared, range(EPISODES))
    if compared.largest > TOLERANCE:
        raise PolicyError(
            f"{controller.called}: its weights as a policy act otherwise than Stable-Baselines3 does, by up to "
            f"{compared.largest:.2g}; its class does something of its own: drive it by a controller class"
        )
    return compared.largest
