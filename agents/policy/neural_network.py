"""A small network of NumPy arrays: a multilayer perceptron with the normalisation it was trained with.

Other families of networks have the same members as :class:`Network`. A layer is x W + b with W of shape
(n_in, n_out); the network is, in float32,

    x = clip((observation - mean) / std, low, high)          x = activation(x W + b) for each layer but the last
    output = scale squash(x W + b + x_0 skip)                clip to [-1, 1], tanh, or none; x_0 the first x
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

ACTIVATIONS = {
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, np.float32(0.0)),
    "elu": lambda x: np.where(x > 0, x, np.expm1(np.minimum(x, np.float32(0.0)))),
    "silu": lambda x: x * (np.float32(0.5) + np.float32(0.5) * np.tanh(np.float32(0.5) * x)),
}
FURTHER = ("mean", "std", "clip", "skip", "scale")
"""Names of the arrays of a network next to its layers."""
SQUASHES = {"clip": lambda x: np.clip(x, -1.0, 1.0), "tanh": np.tanh, "none": lambda x: x}


class PolicyError(ValueError):
    """A policy, or a file of one, that cannot be used; the message names file, field, value and remedy."""


class Network:
    """A multilayer perceptron with its normalisation; its arrays are float32.

    Parameters
    ----------
    layers
        (weight, bias) of each layer, (n_in, n_out) and (n_out,).
    activation
        Activation of every layer but the last: tanh, relu, elu or silu.
    squash
        What bounds the output: clip, tanh or none.
    mean, std
        Mean and standard deviation of the observation, (n_observation,) each; none by default.
    clip
        Largest normalised observation, or the least and the largest of each, (2, n_observation); none by default.
    skip
        Straight from the normalised observation to the output, (n_in, n_out); none by default.
    scale
        Factor of each output, after the squash, (n_out,); none by default.

    Raises
    ------
    PolicyError
        For shapes that do not fit each other, figures that are not finite, or an unknown name.
    """

    family: ClassVar[str] = "perceptron"

    def __init__(
        self,
        layers: Sequence[tuple[ArrayLike, ArrayLike]],
        activation: str = "tanh",
        squash: str = "clip",
        mean: ArrayLike | None = None,
        std: ArrayLike | None = None,
        clip: float | ArrayLike | None = None,
        skip: ArrayLike | None = None,
        scale: ArrayLike | None = None,
    ):
        for field, value, choices in (("activation", activation, ACTIVATIONS), ("squash", squash, SQUASHES)):
            if value not in choices:
                raise PolicyError(f"{field} is {value!r}; choose one of {', '.join(choices)}")
        if not len(layers):
            raise PolicyError("layers is empty; give at least one (weight, bias)")
        self.layers = [(figures(f"w{i}", w, 2), figures(f"b{i}", b, 1)) for i, (w, b) in enumerate(layers)]
        self.activation, self.squash = activation, squash
        n = self.n_in
        for i, (weight, bias) in enumerate(self.layers):
            if weight.shape != (n, len(bias)):
                raise PolicyError(f"w{i} has shape {weight.shape}; with {n} inputs and b{i} it must be {n, len(bias)}")
            n = len(bias)
        self.mean = None if mean is None else self._of_inputs("mean", mean)
        self.std = None if std is None else self._of_inputs("std", std)
        if self.std is not None and not (self.std > 0).all():
            raise PolicyError(f"std is {self.std.min()} somewhere; give figures above 0")
        self.clip = clip if clip is None or isinstance(clip, int | float) else figures("clip", clip, 2)
        if isinstance(self.clip, int | float) and not 0 < self.clip < np.inf:
            raise PolicyError(f"clip is {clip!r}; give a number above 0, or none")
        self.skip = None if skip is None else figures("skip", skip, 2)
        self.scale = None if scale is None else figures("scale", scale, 1)
        shapes = {"clip": (2, self.n_in), "skip": (self.n_in, self.n_out), "scale": (self.n_out,)}
        for name, shape in shapes.items():
            array = getattr(self, name)
            if isinstance(array, np.ndarray) and array.shape != shape:
                raise PolicyError(f"{name} has shape {array.shape}; it must be {shape}")

    def _of_inputs(self, name: str, value: ArrayLike) -> np.ndarray:
        array = figures(name, value, 1)
        if array.shape != (self.n_in,):
            raise PolicyError(f"{name} has shape {array.shape}; give one figure for each of {self.n_in} inputs")
        return array

    @property
    def n_in(self) -> int:
        """Width of the observation."""
        return len(self.layers[0][0])

    @property
    def n_out(self) -> int:
        """Width of the action."""
        return len(self.layers[-1][1])

    def normalised(self, observation: np.ndarray) -> np.ndarray:
        """Return the normalised observation, float32, (..., n_in)."""
        x = np.asarray(observation, dtype=np.float32)
        if self.mean is not None:
            x = x - self.mean
        if self.std is not None:
            x = x / self.std
        if self.clip is not None:
            low, high = self.clip if isinstance(self.clip, np.ndarray) else (-self.clip, self.clip)
            x = np.clip(x, np.float32(low), np.float32(high))
        return x

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Output, float32, (..., n_out), for an observation (..., n_in)."""
        x = self.normalised(observation)
        straight = 0.0 if self.skip is None else x @ self.skip
        for i, (weight, bias) in enumerate(self.layers):
            x = (ACTIVATIONS[self.activation](x) if i else x) @ weight + bias
        output = SQUASHES[self.squash](x + straight)
        return output if self.scale is None else output * self.scale

    def arrays(self) -> dict[str, np.ndarray]:
        """``w0, b0, w1, ..`` and, where there are such arrays, ``mean``, ``std``, ``clip``, ``skip`` and ``scale``."""
        arrays = {
            f"{kind}{i}": array for i, layer in enumerate(self.layers) for kind, array in zip("wb", layer, strict=True)
        }
        further = {name: getattr(self, name) for name in FURTHER}
        return arrays | {name: array for name, array in further.items() if isinstance(array, np.ndarray)}

    def settings(self) -> dict[str, Any]:
        """Number of layers, activation, squash, and clip if it is a number."""
        return {
            "layers": len(self.layers),
            "activation": self.activation,
            "squash": self.squash,
            "clip": None if isinstance(self.clip, np.ndarray) else self.clip,
        }

    @classmethod
    def read(cls, arrays: Mapping[str, np.ndarray], settings: Mapping[str, Any]) -> Self:
        """The network of these arrays and settings."""
        layers = [(arrays[f"w{i}"], arrays[f"b{i}"]) for i in range(settings["layers"])]
        further = {"clip": settings["clip"]} | {name: arrays[name] for name in FURTHER if name in arrays}
        return cls(layers, settings["activation"], settings["squash"], **further)


def figures(name: str, value: object, dimensions: int) -> np.ndarray:
    """An array of finite float32 with so many dimensions; PolicyError, which names it, for what is none."""
    try:
        with np.errstate(over="ignore"):  # infinite then, and refused as such
            array = np.asarray(value).astype(np.float32, order="C", casting="same_kind")
    except (TypeError, ValueError):
        raise PolicyError(f"{name} is no array of real numbers; give float32") from None
    if array.ndim != dimensions or array.size == 0:
        raise PolicyError(f"{name} has shape {array.shape}; give {dimensions} dimensions, none of them 0")
    if not np.isfinite(array).all():
        raise PolicyError(f"{name} holds {array[~np.isfinite(array)][0]}; give finite numbers (did training diverge?)")
    return array
