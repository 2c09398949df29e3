"""Functions of arrays that have a compiled twin: a kernel that computes the same from the same arguments."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, update_wrapper
from importlib import import_module
from inspect import signature
from typing import Any

import numpy as np

_FLOAT64 = np.dtype(np.float64)


class Twins:
    """A function of arrays that calls its compiled twin where that takes the arguments."""

    def __init__(self, array_form: Callable[..., Any], kernel: str, like: str, views: Sequence[str]):
        update_wrapper(self, array_form)
        self.array_form = array_form
        place = list(signature(array_form).parameters).index
        self._kernel, self._like, self._views = kernel, place(like), tuple(map(place, views))

    def __call__(self, *args: Any) -> Any:
        """Run the twin if it takes these arguments, else the array form."""
        like = args[self._like]
        if isinstance(like, tuple):
            like = like[0]
        if type(like) is not np.ndarray or like.ndim != 2 or like.dtype != _FLOAT64:
            return self.array_form(*args)
        for position in self._views:
            value = args[position]
            if value is not None and not value.flags.c_contiguous:
                args = (*args[:position], np.ascontiguousarray(value), *args[position + 1 :])
        return self.kernel(*args)

    @cached_property
    def kernel(self) -> Callable[..., Any]:
        """The compiled twin, imported on first use because it brings the compiler with it."""
        module, name = self._kernel.split(":")
        return getattr(import_module(module), name)


TWINS: dict[str, Twins] = {}
"""All pairs of the modules that have been imported, by ``module:kernel``."""


def compiled_as(kernel: str, like: str, views: Sequence[str] = ()) -> Callable[[Callable[..., Any]], Twins]:
    """Bind a function of arrays to its compiled twin.

    Parameters
    ----------
    kernel
        Where the twin is, ``module:kernel``. It takes the same arguments and gives as many arrays.
    like
        The argument that decides. The twin runs if it is a NumPy array (row, column) of float64, or a tuple that begins
        with one. Tensors, other precisions and other numbers of dimensions go through the array form.
    views
        Arguments that may be views of larger arrays or None. The twin is given contiguous arrays, so that it is
        compiled once.
    """

    def bind(array_form: Callable[..., Any]) -> Twins:
        return TWINS.setdefault(kernel, Twins(array_form, kernel, like, views))

    return bind
