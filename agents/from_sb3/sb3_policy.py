"""A model of Stable-Baselines3 as a policy of NumPy arrays, of any of the views in which SB3 trains."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dcgrid_env import SCENARIO_REGISTRY, Scenario, make_scenario, under_own_control
from dcgrid_env.agents.from_sb3.sb3_zip import REMEDY, Actor, read_actor
from dcgrid_env.agents.policy.neural_network import Network, PolicyError
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.training.row_form import RowForm
from dcgrid_env.agents.training.row_networks import policy_of_rows
from dcgrid_env.agents.training.row_views import Rows, make_rows
from dcgrid_env.agents.training.validation import made_with
from dcgrid_env.core.suggestions import from_clone

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

BEHIND_VEC_NORMALIZE = (
    "it was trained behind VecNormalize, whose statistics are no part of the zip; convert it with `dcgrid export-sb3 "
    "--normalize FILE.pkl --trust`, FILE.pkl being that of VecNormalize.save"
)


class UnknownNormalisationWarning(UserWarning):
    """Warning that a model's file does not show whether its observations were scaled by VecNormalize."""


class Normalisation(NamedTuple):
    """What VecNormalize does to observations: clip((x - mean) / std, -clip, clip), (n_observation,) each."""

    mean: np.ndarray
    std: np.ndarray
    clip: float

    @classmethod
    def from_envs(cls, envs: Any) -> Normalisation | None:
        """Return that of a VecNormalize; None if it does not change observations."""
        if not envs.norm_obs:
            return None
        moments = envs.obs_rms
        return cls(moments.mean, np.sqrt(moments.var + envs.epsilon), float(envs.clip_obs))

    def before(self, network: Network) -> Network:
        """Return a network that normalises its observation in this way first; PolicyError for another width."""
        if len(self.mean) != network.n_in:
            raise PolicyError(
                f"normalize has {len(self.mean)} figures and the observation {network.n_in}; give the file of this "
                "training"
            )
        mean, std, clip = self.mean, self.std, self.clip
        if network.mean is not None and network.std is not None and isinstance(network.clip, float):
            low, high = ((end - network.mean) / network.std for end in (-clip, clip))
            mean, std = mean + std * network.mean, std * network.std
            clip = np.clip([low, high], -network.clip, network.clip)
        return Network(network.layers, network.activation, network.squash, mean, std, clip)


def to_policy(model: BaseAlgorithm, scenario: str | Scenario | None = None) -> Policy:
    """Return a policy that acts as ``predict(deterministic=True)`` of a model of Stable-Baselines3.

    Its ``save`` writes a file that dcgrid runs without torch and without Stable-Baselines3. The means of a VecNormalize
    around the model's environment become part of the policy.

    Parameters
    ----------
    model
        PPO, A2C, SAC, TD3 or DDPG with MlpPolicy, trained on ``sb3_vec_env`` or ``gymnasium.make``.
    scenario
        What it was trained on: a preset's name, or a Scenario. Default: the one that the model's action space names,
        which has a name only for ``sb3_vec_env``.

    Raises
    ------
    PolicyError
        A ValueError, if a policy cannot represent the model, or the scenario is missing or does not fit.
    """
    content = io.BytesIO()
    model.save(content)
    actor, normalised = read_actor(content), model.get_vec_normalize_env()
    if normalised is None:
        return as_policy(actor, scenario)
    return as_policy(actor._replace(is_normalised=False), scenario, Normalisation.from_envs(normalised))


def read_policy(path: str | Path, scenario: str | Scenario | None = None) -> Policy:
    """Return the policy of a zip that ``model.save`` wrote; no object in it is unpickled.

    Parameters
    ----------
    path
        Zip of a model of Stable-Baselines3.
    scenario
        What it was trained on if the zip does not name it, or names one that it does not fit.

    Raises
    ------
    PolicyError
        A ValueError, if the file is not such a zip, or see :func:`to_policy`. Also if torch is not installed.
    """
    return _read(Path(path), scenario)[0]


def convert(path: Path, out: Path) -> Path:
    """Write the policy of a zip that ``model.save`` wrote to a file and return the file; see :func:`read_policy`."""
    policy, actor = _read(path, None)
    return policy.save(out, actor.card)


def _read(path: Path, scenario: str | Scenario | None) -> tuple[Policy, Actor]:
    try:
        actor = read_actor(path)
    except ImportError as error:
        raise PolicyError(f"{path}: reading a model needs {error.name}; {from_clone('agents')}") from None
    try:
        try:
            policy = as_policy(actor, None)
        except PolicyError:
            if scenario is None:
                raise
            policy = as_policy(actor, scenario)
    except PolicyError as error:
        raise PolicyError(f"{path}: {error}") from None
    if actor.is_normalised is None and actor.network.mean is None:
        warnings.warn(
            f"{path}: a zip of {actor.algorithm} does not show whether the model was trained behind VecNormalize; if "
            "it was, convert it with `dcgrid export-sb3 --normalize FILE.pkl --trust`",
            UnknownNormalisationWarning,
            stacklevel=3,
        )
    policy.source = str(path)
    return policy, actor


def as_policy(
    actor: Actor,
    scenario: str | Scenario | None,
    normalisation: Normalisation | None = None,
    label: str | None = None,
) -> Policy:
    """Return the policy whose actions are those of SB3's ``predict(deterministic=True)``, to the rounding of float32.

    Parameters
    ----------
    actor
        What :func:`read_actor` read.
    scenario
        What it was trained on; its agents define the actor's inputs and outputs. Default: the one that it names.
    normalisation
        That of the VecNormalize which it was trained behind.
    label
        Name of the scenario in the policy; by default the scenario's.

    Raises
    ------
    PolicyError
        If the scenario is missing or does not fit, or if the actor drives regulators or capacitor banks itself. Also if
        it was trained behind a VecNormalize that is not given.
    """
    if actor.is_normalised and normalisation is None:
        raise PolicyError(BEHIND_VEC_NORMALIZE)
    network = actor.network if normalisation is None else normalisation.before(actor.network)
    trained = training_scenario(actor.form, scenario)
    rows = rows_for(trained, (network.n_in, network.n_out), actor.form)
    if under_own_control(rows.scenario, keep_set_points=True) is not rows.scenario:
        raise PolicyError(
            f"it drives the regulators or capacitor banks of {trained.name} too, which a policy leaves under their "
            f"own control; {REMEDY}"
        )
    return policy_of_rows(rows, network, scenario=label or trained.name, made_with=made_with())


def training_scenario(form: RowForm | None, scenario: str | Scenario | None) -> Scenario:
    """Return what a model was trained on: a scenario that is given, else the one that its form names.

    Raises PolicyError if there is neither.
    """
    scenario = scenario or named_scenario(form)
    if scenario is None:
        raise PolicyError("it names no scenario of dcgrid list; give the scenario that it was trained on")
    return make_scenario(scenario, split="train")


def named_scenario(form: RowForm | None) -> str | None:
    """Return the name of the scenario that a form was trained on; None if the name is not registered.

    Text of a file must not select code, as ``file.py:function`` would.
    """
    return form.scenario if form is not None and form.scenario in SCENARIO_REGISTRY else None


def rows_for(scenario: Scenario, widths: tuple[int, int], form: RowForm | None = None) -> Rows:
    """Return the rows whose observation and action have these widths, of a form if it is known.

    Without a form they are those of ``gymnasium.make``, of all agents or without regulators and capacitor banks, or
    the shared view. Raises PolicyError, with the widths that there are, if none fits.
    """
    others, widths_there = under_own_control(scenario, keep_set_points=True), []
    for each in (RowForm("joint"), RowForm("shared")) if form is None else (form,):
        for candidate in (scenario, others) if each.view == "joint" and others is not scenario else (others,):
            rows = make_rows(candidate, each)
            if (rows.n_observation, rows.n_action) == widths:
                return rows
            widths_there.append(f"{rows.n_observation} and {rows.n_action} ({each.view})")
    raise PolicyError(
        f"observation and action have {widths[0]} and {widths[1]} figures; on {scenario.name} they have "
        f"{', '.join(widths_there)}: name the scenario that it was trained on, or {REMEDY}"
    )
