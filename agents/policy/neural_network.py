"""A small network of NumPy arrays: a multilayer perceptron with the normalisation it was trained with.

Other families of networks have the same interface, :class:`Family`. A layer is x W + b with W of shape
(n_in, n_out); the network is, in float32,

    x = clip((observation - mean) / std, -clip, clip)        x = activation(x W + b) for each layer but the last
    output = squash(x W + b + x_0 skip)                      clip to [-1, 1], tanh, or none; x_0 the first x
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

ACTIVATIONS = {
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, np.float32(0.0)),
    "elu": lambda x: np.where(x > 0, x, np.expm1(np.minimum(x, np.float32(0.0)))),
    "silu": lambda x: x * (np.float32(0.5) + np.float32(0.5) * np.tanh(np.float32(0.5) * x)),
}
SQUASHES = {"clip": lambda x: np.clip(x, -1.0, 1.0), "tanh": np.tanh, "none": lambda x: x}


class PolicyError(ValueError):
    """A policy, or a file of one, that cannot be used; the message names file, field, value and remedy."""


class Family(Protocol):
    """What a policy asks of a network: to be run, and to be written as arrays and settings and read again."""

    family: ClassVar[str]
    """Its name in files, and in ``families.FAMILIES``."""

    @property
    def n_in(self) -> int:
        """Width of the observation."""
        ...

    @property
    def n_out(self) -> int:
        """Width of the action."""
        ...

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Output, float32, (..., n_out), for an observation (..., n_in)."""
        ...

    def arrays(self) -> dict[str, np.ndarray]:
        """All its figures, float32."""
        ...

    def settings(self) -> dict[str, Any]:
        """What else makes it, as JSON takes it."""
        ...

    @classmethod
    def read(cls, arrays: Mapping[str, np.ndarray], settings: Mapping[str, Any]) -> Self:
        """The network of these ``arrays()`` and ``settings()``.

        KeyError for what is missing, PolicyError for what cannot be.
        """
        ...


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
        Largest normalised observation; none by default.
    skip
        Straight from the normalised observation to the output, (n_in, n_out); none by default.

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
        clip: float | None = None,
        skip: ArrayLike | None = None,
    ):
        for field, value, choices in (("activation", activation, ACTIVATIONS), ("squash", squash, SQUASHES)):
            if value not in choices:
                raise PolicyError(f"{field} is {value!r}; choose one of {', '.join(choices)}")
        if clip is not None and not (isinstance(clip, int | float) and 0 < clip < np.inf):
            raise PolicyError(f"clip is {clip!r}; give a number above 0, or none")
        if not len(layers):
            raise PolicyError("layers is empty; give at least one (weight, bias)")
        self.layers = [(figures(f"w{i}", w, 2), figures(f"b{i}", b, 1)) for i, (w, b) in enumerate(layers)]
        self.activation, self.squash, self.clip = activation, squash, clip
        n = self.n_in
        for i, (weight, bias) in enumerate(self.layers):
            if weight.shape != (n, len(bias)):
                raise PolicyError(f"w{i} has shape {weight.shape}; with {n} inputs and b{i} it must be {n, len(bias)}")
            n = len(bias)
        self.mean = None if mean is None else self._of_inputs("mean", mean)
        self.std = None if std is None else self._of_inputs("std", std)
        if self.std is not None and not (self.std > 0).all():
            raise PolicyError(f"std is {self.std.min()} somewhere; give figures above 0")

        self.skip = None if skip is None else figures("skip", skip, 2)
        if self.skip is not None and self.skip.shape != (self.n_in, self.n_out):
            raise PolicyError(f"skip has shape {self.skip.shape}; it must be {self.n_in, self.n_out}")

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

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Output, float32, (..., n_out), for an observation (..., n_in)."""
        x = np.asarray(observation, dtype=np.float32)
        if self.mean is not None:
            x = x - self.mean
        if self.std is not None:
            x = x / self.std
        if self.clip is not None:
            x = np.clip(x, np.float32(-self.clip), np.float32(self.clip))
        straight = 0.0 if self.skip is None else x @ self.skip
        for i, (weight, bias) in enumerate(self.layers):
            x = (ACTIVATIONS[self.activation](x) if i else x) @ weight + bias
        return SQUASHES[self.squash](x + straight)

    def arrays(self) -> dict[str, np.ndarray]:
        """``w0, b0, w1, ..`` and, where there are, ``mean``, ``std`` and ``skip``."""
        arrays = {
            f"{kind}{i}": array for i, layer in enumerate(self.layers) for kind, array in zip("wb", layer, strict=True)
        }
        return arrays | {name: array for name in ("mean", "std", "skip") if (array := getattr(self, name)) is not None}

    def settings(self) -> dict[str, Any]:
        """Number of layers, activation, squash and clip."""
        return {
            "layers": len(self.layers),
            "activation": self.activation,
            "squash": self.squash,
            "clip": self.clip,
        }

    @classmethod
    def read(cls, arrays: Mapping[str, np.ndarray], settings: Mapping[str, Any]) -> Self:
        """The network of these arrays and settings."""
        layers = [(arrays[f"w{i}"], arrays[f"b{i}"]) for i in range(settings["layers"])]
        mean, std, skip = (arrays.get(name) for name in ("mean", "std", "skip"))
        return cls(layers, settings["activation"], settings["squash"], mean, std, settings["clip"], skip)


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
