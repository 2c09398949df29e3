"""Read the actor of a Stable-Baselines3 zip without running code from it.

``model.save`` writes two files. ``policy.pth`` contains the weights; ``torch.load(weights_only=True)`` reads them and
creates only tensors. ``data`` is JSON with pickled objects and, next to each, its fields as plain text. The text and
the names and shapes of the weights identify networks made by SB3's classes. The pickles are never opened.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from dcgrid_env.agents.policy.neural_network import Network, PolicyError
from dcgrid_env.agents.training.row_batch import CLIP
from dcgrid_env.agents.training.row_form import RowForm
from dcgrid_env.core.user_files import is_file, parse_json

SUFFIX = ".zip"
MOST_MIB = 256
"""Maximum size of a file in a zip, MiB."""
REMEDY = (
    "run it with dcgrid evaluate and --trust, or drive it by a controller class of some ten lines (docs/own-policy.md)"
)
ACTIVATIONS = {
    f"<class 'torch.nn.modules.activation.{name}'>": name.lower() for name in ("Tanh", "ReLU", "ELU", "SiLU")
}
"""Activations in ``policy_kwargs`` and their names in dcgrid."""
FLATTEN = "<class 'stable_baselines3.common.torch_layers.FlattenExtractor'>"
NORMALISED = "<class 'dcgrid_env.agents.training.sb3_models.Normalised'>"
"""Features extractor of ``ppo_settings`` and ``sac_settings``, whose means and deviations are among the weights."""
ROW_ACTIONS = "<class 'dcgrid_env.agents.training.row_form.RowActions'>"
"""Action space of ``sb3_vec_env``, which has the form of the rows."""
WITHOUT_EFFECT = {
    ":type:", ":serialized:", "net_arch", "optimizer_class", "optimizer_kwargs", "log_std_init", "ortho_init",
    "full_std", "use_expln", "share_features_extractor", "normalize_images", "n_critics", "use_sde",
    "features_extractor_kwargs",
}  # fmt: skip
"""Settings in ``policy_kwargs`` that do not affect the mean action or follow from the weights."""
READ = {"activation_fn", "features_extractor_class", "squash_output", "clip_mean"}
"""Settings in ``policy_kwargs`` that are read."""


class _Form(NamedTuple):
    """Names of the weights of an actor."""

    module: str
    """Module of the policy class."""
    extractor: str
    """Names of the features extractor's arrays begin so."""
    hidden: str
    last: str
    """Name of the last layer; empty if it is the last one of ``hidden``."""
    activation: str
    """Default activation, which ``policy_kwargs`` can override."""
    beside: tuple[str, ...]
    """Weights that the mean action does not use."""


_ACTOR_CRITIC = _Form(
    "stable_baselines3.common.policies", "pi_features_extractor.", "mlp_extractor.policy_net.", "action_net.", "tanh",
    ("log_std", "mlp_extractor.value_net.", "value_net.", "features_extractor.", "vf_features_extractor."),
)  # fmt: skip
_OF_SAC = _Form(
    "stable_baselines3.sac.policies", "actor.features_extractor.", "actor.latent_pi.", "actor.mu.", "relu",
    ("actor.log_std", "critic"),
)  # fmt: skip
_OF_TD3 = _Form(
    "stable_baselines3.td3.policies", "actor.features_extractor.", "actor.mu.", "", "relu", ("actor_target.", "critic"),
)  # fmt: skip
FORMS = {"ppo": _ACTOR_CRITIC, "a2c": _ACTOR_CRITIC, "sac": _OF_SAC, "td3": _OF_TD3, "ddpg": _OF_TD3}


class Actor(NamedTuple):
    """The mean action of a model of Stable-Baselines3, as weights."""

    algorithm: str
    """One of ``FORMS``."""
    network: Network
    """Network from the model's observation to its action."""
    form: RowForm | None
    """Form of the rows that the model acts on; None if it was not trained on those of ``sb3_vec_env``."""
    is_normalised: bool | None
    """Whether the model was trained with VecNormalize; None if the file does not contain this information."""
    seed: int | None

    @property
    def card(self) -> dict[str, Any]:
        """Origin of the policy, see ``Policy.save``."""
        return {"algorithm": f"sb3-{self.algorithm}", "seed": self.seed}


def read_actor(file: Path | IO[bytes]) -> Actor:
    """Read the actor of a zip that ``model.save`` wrote, without unpickling any object.

    Parameters
    ----------
    file
        The zip: a path, or its open content.

    Raises
    ------
    PolicyError
        If the file is not such a zip, or a :class:`Network` cannot represent the model. The message lists what is
        allowed.
    OSError
        If the file cannot be opened.
    """
    called = file if isinstance(file, Path) else "model"
    try:
        about, weights = _contents(file)
        algorithm = algorithm_of(about)
        names = FORMS[algorithm]
        kwargs = about.get("policy_kwargs") or {}
        _check_expressible(about, kwargs, algorithm)
        extractor = {} if kwargs.get("features_extractor_class") != NORMALISED else _moments(weights, names.extractor)
        activation = ACTIVATIONS[kwargs["activation_fn"]] if "activation_fn" in kwargs else names.activation
        squash = "tanh" if names is not _ACTOR_CRITIC or kwargs.get("squash_output") else "clip"
        network = Network(_layers(weights, names), activation, squash, **extractor)
        behind = about.get("_last_original_obs") is not None if names is _ACTOR_CRITIC else None
        seed = about.get("seed")
        return Actor(algorithm, network, form_in(about), behind, seed if isinstance(seed, int) else None)
    except PolicyError as error:
        raise PolicyError(f"{called}: {error}") from None
    except (TypeError, AttributeError, KeyError, ValueError) as error:
        raise PolicyError(
            f"{called}: data is not what Stable-Baselines3 writes ({error!r}); save the model again"
        ) from None


def form_in(about: Mapping[str, Any]) -> RowForm | None:
    """Return the form of the rows from a model's description; None without one, PolicyError if it is invalid."""
    space = about["action_space"]
    return RowForm.read(space.get("form")) if space.get(":type:") == ROW_ACTIONS else None


def trained_scenario(path: Path) -> str:
    """Return the name of the scenario that a zip says its model was trained on; empty if it says none.

    Raises PolicyError if the file is not such a zip.
    """
    try:
        form = form_in(read_about(path))
    except PolicyError as error:
        raise PolicyError(f"{path}: {error}") from None
    except (TypeError, AttributeError, KeyError):
        return ""
    return form.scenario if form else ""


def read_about(file: Path | IO[bytes]) -> dict[str, Any]:
    """Return the JSON description of the model, pickles as text; raise PolicyError if the file is not such a zip."""
    if isinstance(file, Path) and not is_file(file, PolicyError):
        raise PolicyError("there is no such file; give the zip that Stable-Baselines3's model.save wrote")
    try:
        with zipfile.ZipFile(file) as archive:
            return dict(parse_json(_part(archive, "data"), "data", ValueError, REMEDY))
    except (PolicyError, OSError):
        raise
    except Exception:  # of the zip's reader, whatever the file holds
        raise PolicyError("not a zip that Stable-Baselines3 wrote; give one of model.save") from None


def algorithm_of(about: Mapping[str, Any]) -> str:
    """Identify the algorithm by its specific settings; raise PolicyError if it is not in ``FORMS``."""
    if "cg_max_steps" not in about and "gae_lambda" in about:
        return "ppo" if "clip_range" in about else "a2c"
    if "target_entropy" in about and "top_quantiles_to_drop_per_net" not in about:
        return "sac"
    if "policy_delay" in about:
        return "ddpg" if about.get("target_noise_clip") == 0.0 else "td3"
    raise PolicyError(f"algorithm is none of {', '.join(FORMS)}; {REMEDY}")


def _contents(file: Path | IO[bytes]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the contents of ``data``, and the weights by name."""
    about, torch = read_about(file), import_module("torch")
    try:
        with zipfile.ZipFile(file) as archive:
            content = _part(archive, "policy.pth")
        state = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        if sum(tensor.numel() for tensor in state.values()) > MOST_MIB * 2**18:  # views of a few stored figures can be
            raise PolicyError(f"policy.pth has weights of more than {MOST_MIB} MiB; give a smaller model")
        return about, {name: tensor.detach().float().numpy() for name, tensor in state.items()}
    except PolicyError:
        raise
    except Exception as error:  # of torch's own reader, whatever the file holds
        raise PolicyError(
            f"policy.pth cannot be read as weights alone ({type(error).__name__}); save the model again with "
            "stable-baselines3"
        ) from None


def _part(archive: zipfile.ZipFile, name: str) -> bytes:
    """Read a file of the zip; raise PolicyError if it is missing or too large."""
    if name not in archive.namelist():
        raise PolicyError(f"{name} is missing; give a zip that Stable-Baselines3's model.save wrote")
    part = archive.getinfo(name)
    size_mib = part.file_size / 2**20
    if size_mib > MOST_MIB:
        raise PolicyError(f"{name} has {size_mib:.0f} MiB; give a model of at most {MOST_MIB} MiB")
    if part.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # others are unpacked without a bound
        raise PolicyError(f"{name} is compressed in another way than by model.save; save the model again")
    with archive.open(part) as file:  # archive.read would unpack more than the size that the file states
        return file.read(part.file_size)


def _check_expressible(about: Mapping[str, Any], kwargs: Mapping[str, Any], algorithm: str) -> None:
    """Raise PolicyError, with the setting's name, unless the model is a multilayer perceptron on a Box."""
    module = about["policy_class"].get("__module__")
    if module != FORMS[algorithm].module:
        raise PolicyError(f"policy_class is one of {module}, not SB3's MlpPolicy; {REMEDY}")
    for space in ("observation_space", "action_space"):
        kind = about[space].get(":type:", "")
        if not kind.endswith(".box.Box'>") and kind != ROW_ACTIONS:
            raise PolicyError(f"{space} is {kind}, not a Box; {REMEDY}")
    for edge, value in (("low", -1.0), ("high", 1.0)):
        ends = set(re.findall(r"-?[\d.]+(?:e[-+]?\d+)?|-?inf", about["action_space"][edge].replace("...", " ")))
        if {float(end) for end in ends} != {value}:
            raise PolicyError(
                f"action_space: {edge} is {about['action_space'][edge]!r}, that of dcgrid is {value:g} everywhere; "
                f"train without a wrapper of actions, or {REMEDY}"
            )
    for name in kwargs:
        if name not in WITHOUT_EFFECT | READ:
            raise PolicyError(f"policy_kwargs: {name} is not known; {REMEDY}")
    activation = kwargs.get("activation_fn")
    if activation is not None and activation not in ACTIVATIONS:
        names = ", ".join(ACTIVATIONS.values())
        raise PolicyError(f"policy_kwargs: activation_fn is {activation}, a policy has one of {names}; {REMEDY}")
    extractor = kwargs.get("features_extractor_class", FLATTEN)
    if extractor not in (FLATTEN, NORMALISED):
        raise PolicyError(f"policy_kwargs: features_extractor_class is {extractor}; {REMEDY}")
    if algorithm == "sac" and about.get("use_sde") and kwargs.get("clip_mean", 2.0) > 0.0:
        raise PolicyError(f"use_sde: SAC cuts its mean at clip_mean before tanh, which a policy cannot; {REMEDY}")


def _moments(weights: dict[str, np.ndarray], prefix: str) -> dict[str, Any]:
    """Take the means and deviations of a features extractor from the weights, as arguments of ``Network``."""
    try:
        return {name: weights.pop(f"{prefix}{name}") for name in ("mean", "std")} | {"clip": CLIP}
    except KeyError as missing:
        raise PolicyError(f"policy.pth: {missing.args[0]} is missing; save the model again") from None


def _layers(weights: Mapping[str, np.ndarray], form: _Form) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return (weight, bias) of each layer of the actor; raise PolicyError for weights that do not belong to a layer."""
    actor = {name: value for name, value in weights.items() if not name.startswith(form.beside)}
    layers, place = [], 0
    while f"{form.hidden}{place}.weight" in actor:  # an activation stands between two layers
        layers.append(tuple(actor.pop(f"{form.hidden}{place}.{part}", None) for part in ("weight", "bias")))
        place += 2
    if form.last:
        layers.append(tuple(actor.pop(f"{form.last}{part}", None) for part in ("weight", "bias")))
    if actor:
        raise PolicyError(f"policy.pth: {min(actor)} is no weight of a multilayer perceptron; {REMEDY}")
    if not layers or any(part is None for layer in layers for part in layer):
        raise PolicyError(f"policy.pth: a layer of the actor lacks its weight or bias; {REMEDY}")
    return [(weight.T, bias) for weight, bias in layers]
