"""A Stable-Baselines3 model driven by SB3 itself. Loading it unpickles it, which runs whatever code it holds."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import stable_baselines3
from stable_baselines3.common.save_util import load_from_pkl
from stable_baselines3.common.vec_env import VecNormalize

from dcgrid_env import Scenario, action_layout
from dcgrid_env.agents.from_sb3.sb3_policy import Normalisation, rows_for
from dcgrid_env.agents.from_sb3.sb3_zip import algorithm_of, read_about
from dcgrid_env.agents.policy.neural_network import PolicyError
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.baselines import rollout
from dcgrid_env.baselines.equipment_agents import EquipmentAgents
from dcgrid_env.baselines.user_code import OwnCodeError, described

TOLERANCE = 1e-4
"""Largest difference between an action of an exported policy and SB3's, of a range of 2: the rounding of float32."""
EPISODES = 4
"""Episodes of the training split over which the two are compared."""


class Sb3Controller:
    """A model of Stable-Baselines3 as a controller: the actions are those of ``predict(deterministic=True)``.

    Parameters
    ----------
    path
        Zip that ``model.save`` wrote. It is unpickled.
    normalisation
        That of the VecNormalize which it was trained behind.

    Raises
    ------
    PolicyError
        If the file is not such a zip, or the algorithm is unknown.
    OwnCodeError
        Where Stable-Baselines3 cannot load it.
    """

    def __init__(self, path: Path, normalisation: Normalisation | None = None):
        self.path, self.normalisation = path, normalisation
        try:
            algorithm = getattr(stable_baselines3, algorithm_of(read_about(path)).upper())
        except PolicyError as error:
            raise PolicyError(f"{path}: {error}") from None
        try:
            self.model = algorithm.load(path, device="cpu", custom_objects={"buffer_size": 1})
        except Exception as error:  # whatever the pickles run
            raise OwnCodeError(f"{path}: Stable-Baselines3 cannot load it: {described(error)}") from error

    def reset(self, env_info: Scenario) -> None:
        """Begin episodes; PolicyError where the model's spaces are none of the scenario's."""
        shapes = (self.model.observation_space.shape, self.model.action_space.shape)
        if any(shape is None or len(shape) != 1 for shape in shapes):
            raise PolicyError(f"{self.path}: spaces have the shapes {shapes}; a model for dcgrid has flat ones")
        self._rows = rows_for(env_info, (shapes[0][0], shapes[1][0]))
        self._equipment = EquipmentAgents(env_info, keep_set_points=True)
        self._layout = action_layout(env_info)

    def act(self, observations: Any) -> Any:
        """Actions for observations, in the same form: a mapping of agents, or joint, (..., n_observation)."""
        if self._rows.scenario.agents != self._equipment.scenario.agents:
            return self._equipment.act(observations, self._joint)
        if isinstance(observations, Mapping):
            agents = self._equipment.scenario.agents
            return self._layout.split(self._joint(np.concatenate([observations[agent] for agent in agents], axis=-1)))
        return self._joint(np.asarray(observations))

    def _joint(self, joint: np.ndarray) -> np.ndarray:
        rows = joint.reshape(-1, joint.shape[-1])
        action = self._rows.driven(rows, self._predicted)
        return action.reshape(*joint.shape[:-1], -1)

    def _predicted(self, rows: np.ndarray) -> np.ndarray:
        if self.normalisation is not None:
            mean, std, clip = self.normalisation
            rows = np.clip((rows - mean) / std, -clip, clip).astype(np.float32)
        return self.model.predict(rows, deterministic=True)[0]


def trusted(path: Path) -> Sb3Controller:
    """A controller that runs a model unchanged.

    PolicyError if it was trained behind VecNormalize, without whose statistics its actions are meaningless.
    """
    controller = Sb3Controller(path)
    about = read_about(path)
    if "gae_lambda" in about and about.get("_last_original_obs") is not None:
        raise PolicyError(
            f"{path}: it was trained behind VecNormalize, whose statistics are no part of the zip; convert it with "
            "`dcgrid export-sb3 --normalize FILE.pkl --trust`, FILE.pkl being that of VecNormalize.save"
        )
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
    if not found.norm_obs:
        return None
    moments: Any = found.obs_rms
    return Normalisation(moments.mean, np.sqrt(moments.var + found.epsilon), float(found.clip_obs))


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
            f"{controller.path}: its weights as a policy act otherwise than Stable-Baselines3 does, by up to "
            f"{compared.largest:.2g}; its class does something of its own: drive it by a controller class"
        )
    return compared.largest
