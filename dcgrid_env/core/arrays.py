"""The few array operations that NumPy and torch spell differently, without importing torch."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from array_api_compat import array_namespace

Array = Any
"""A NumPy array or a torch tensor: code that takes either returns the same kind."""


def namespace(array: Array) -> ModuleType:
    """The array-API namespace of a NumPy array or a torch tensor."""
    return np if isinstance(array, np.ndarray) else array_namespace(array)


def as_like(values: Array, like: Array) -> Array:
    """``values`` as an array of the kind, precision and device of ``like``."""
    if isinstance(like, np.ndarray):
        return np.asarray(values, dtype=like.dtype)
    if not hasattr(values, "to"):
        values = array_namespace(like).asarray(np.array(values))  # a copy: tensors cannot share read-only memory
    return values.to(dtype=like.dtype, device=like.device)


def positive_part(array: Array) -> Array:
    """max(array, 0), elementwise."""
    if isinstance(array, np.ndarray):
        return np.maximum(array, 0.0)
    return array_namespace(array).clip(array, 0.0, None)


def positive_sqrt(array: Array) -> Array:
    """sqrt(max(array, 0)), elementwise, with derivative 0 (not infinite) at and below 0."""
    if isinstance(array, np.ndarray):
        return np.sqrt(np.maximum(array, 0.0))
    xp = array_namespace(array)
    return xp.where(array > 0, xp.sqrt(xp.where(array > 0, array, 1.0)), 0.0)


def rounded(array: Array) -> Array:
    """Nearest whole number, the even one of two, elementwise; with the derivative of the array itself (straight
    through), so that a gradient finds its way past what is discrete."""
    if isinstance(array, np.ndarray):
        return np.rint(array)
    return array + (array_namespace(array).round(array) - array).detach()


def all_true(array: Array) -> bool:
    """Whether every entry of a one-dimensional bool array is True."""
    if not isinstance(array, np.ndarray):
        return bool(array.all())
    # A reduction takes some twenty times as long as looking at the one entry that a single environment has.
    return bool(array[0] if array.shape == (1,) else np.logical_and.reduce(array))


def any_true(array: Array) -> bool:
    """Whether any entry of a one-dimensional bool array is True."""
    if not isinstance(array, np.ndarray):
        return bool(array.any())
    return bool(array[0] if array.shape == (1,) else np.logical_or.reduce(array))


def sum_last(array: Array) -> Array:
    """Sum over the last axis."""
    return np.add.reduce(array, -1) if isinstance(array, np.ndarray) else array.sum(-1)


def min_last(array: Array) -> Array:
    """Smallest entry of the last axis, which stays with a length of 1."""
    return array.min(-1, keepdims=True) if isinstance(array, np.ndarray) else array.amin(-1, keepdim=True)


def put_rows(base: Array, rows: Array, new: Array) -> Array:
    """A copy of ``base`` with other rows at the positions ``rows``, (k,) int."""
    if isinstance(base, np.ndarray):
        out = base.copy()
        out[rows] = new
        return out
    return base.index_copy(0, rows, new)


def add_at(base: Array, flat_index: Array, values: Array) -> Array:
    """A copy of ``base`` with ``values`` added at the flat positions ``flat_index``, some of which may be the same."""
    if isinstance(base, np.ndarray):
        out = base.copy()
        np.add.at(out.reshape(-1), flat_index, values)
        return out
    return base.reshape(-1).index_add(0, flat_index.reshape(-1), values.reshape(-1)).reshape(base.shape)


def take_at(base: Array, flat_index: Array) -> Array:
    """Elements of ``base`` at the flat positions ``flat_index``, in its shape."""
    return base.take(flat_index) if isinstance(base, np.ndarray) else base.reshape(-1)[flat_index]


def take_last(array: Array, positions: Array) -> Array:
    """Entries of the last axis at ``positions``, one index for all leading dimensions."""
    if isinstance(array, np.ndarray):
        return array.take(positions, axis=-1)
    # A gather: several times faster in torch than its index_select along the last axis.
    return array.gather(-1, positions.expand(*array.shape[:-1], positions.shape[0]))


def requires_grad(*arrays: Array) -> bool:
    """Whether a derivative is being recorded for any of the arrays."""
    return any(getattr(a, "requires_grad", False) for a in arrays)
