"""Formulas that are written once: for kernels, for arrays over environments and slots, and for tensors.

    @formula(like="p_kw")
    def dispatch(s_rated_kva: PerSlot, q_max_kvar: PerSlot, p_kw: Array, asked_kvar: Array) -> tuple[Array, Array]:
        limit = least(root(s_rated_kva * s_rated_kva - p_kw * p_kw), q_max_kvar)
        return least(most(asked_kvar, -limit), limit), limit

The body is a function of numbers. It uses arithmetic, comparisons, ``abs``, other formulas, and the five functions
below instead of those of NumPy. A choice between two values is ``choose``; ``if`` is for settings only.

A function whose kernel cannot be made from its body is bound to a kernel that is written separately (``compiled_as``).
"""

from __future__ import annotations

import types
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cache, cached_property, update_wrapper
from importlib import import_module
from inspect import signature
from typing import Any

import numpy as np

from dcgrid_env.core.arrays import Array, namespace, positive_part, positive_sqrt

_FLOAT64 = np.dtype(np.float64)
PerSlot = Array
"""Annotation of an argument with a value for each slot, (slot,)."""


def least(a: Array, b: Array) -> Array:
    """The smaller of two values, of which the second may be a number."""
    return namespace(a).minimum(a, _like(b, a))


def most(a: Array, b: Array) -> Array:
    """The larger of two values, of which the second may be a number."""
    return namespace(a).maximum(a, _like(b, a))


def positive(a: Array) -> Array:
    """max(a, 0)."""
    return positive_part(a)


def root(a: Array) -> Array:
    """sqrt(max(a, 0)), with derivative 0 at and below 0."""
    return positive_sqrt(a)


def choose(condition: Array, a: Array | float, b: Array | float) -> Array:
    """``a`` where the condition is True, else ``b``; one of them may be a number."""
    return namespace(condition).where(condition, a, b)


def _least(a, b):
    return b if b < a else a


def _most(a, b):
    return b if b > a else a


def _positive(a):
    return 0.0 if a < 0.0 else a


def _root(a):
    return np.sqrt(0.0 if a < 0.0 else a)


def _choose(condition, a, b):
    return a if condition else b


_OF_NUMBERS = {"least": _least, "most": _most, "positive": _positive, "root": _root, "choose": _choose}
"""The five functions for numbers; a value that is not finite remains so."""


def _like(value: Array | float, like: Array) -> Array:
    """A number as a tensor without dimensions, if the other value is a tensor: its minimum takes no number."""
    if isinstance(value, float) and not isinstance(like, np.ndarray):
        return namespace(like).full((), value, dtype=like.dtype, device=like.device)
    return value


class RowFunction(ABC):
    """A function of arrays that runs as a kernel over arrays (row, slot).

    Parameters
    ----------
    array_form
        The function itself, for arrays of any kind and shape.
    like
        The argument that decides: the kernel runs if it is a NumPy array of float64 with two dimensions, or a tuple
        that begins with one. Without ``like`` the array form always runs.
    views
        Arguments that may be views of larger arrays, or None. The kernel is given contiguous arrays, so it is compiled
        once.
    """

    def __init__(self, array_form: Callable[..., Any], like: str | None, views: Sequence[str]):
        update_wrapper(self, array_form)
        self.array_form = array_form
        place = list(signature(array_form).parameters).index
        self._like, self._views = None if like is None else place(like), tuple(map(place, views))

    @cached_property
    @abstractmethod
    def kernel(self) -> Callable[..., Any]:
        """The kernel, imported on first use because it brings the compiler with it."""

    def __call__(self, *args: Any) -> Any:
        """Run the kernel if it takes these arguments, else the array form."""
        if self._like is None:
            return self.array_form(*args)
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


class Twins(RowFunction):
    """A function of arrays and its kernel, which is written separately; see ``compiled_as``."""

    def __init__(self, array_form: Callable[..., Any], kernel: str, like: str, views: Sequence[str]):
        super().__init__(array_form, like, views)
        self._kernel = kernel

    @cached_property
    def kernel(self) -> Callable[..., Any]:
        """See ``RowFunction``."""
        module, name = self._kernel.split(":")
        return getattr(import_module(module), name)


class Formula(RowFunction):
    """A formula; see ``formula``. Called with arrays, it computes them elementwise."""

    @cached_property
    def scalar(self) -> Any:
        """The kernel of one element, for use in other kernels."""
        from dcgrid_env.core.compiled import compiled  # brings the compiler with it

        return compiled(self._with_kernels(), inner=True)

    @cached_property
    def kernel(self) -> Any:
        """The kernel over arrays (row, slot), see ``formula``.

        Several results are the parts of one array (result, row, slot), because each array that a kernel returns takes
        as long as the formula of a few slots.
        """
        from dcgrid_env.core.compiled import compiled

        names, kinds = list(signature(self.array_form).parameters), self.array_form.__annotations__
        assert self._like is not None
        like, taken, checks = names[self._like], [], []
        for name in names:
            if kinds[name] == "PerSlot":
                taken.append(f"{name}[i]")
                checks.append(f"len({name}) != slots")
            elif kinds[name] == "Array":
                taken.append(f"{name}[row, i]")
                checks.append(f"{name}.shape != {like}.shape")
            elif kinds[name] == "Array | None":
                taken.append(f"None if {name} is None else {name}[row, i]")
                checks.append(f"{name} is not None and {name}.shape != {like}.shape")
            else:
                taken.append(name)
        n_out = kinds["return"].count("Array")
        shape, at = ("n_row, slots", "") if n_out == 1 else (f"{n_out}, n_row, slots", "{}, ")
        filled = ", ".join(f"out[{at.format(k)}row, i]" for k in range(n_out))
        refuse = "        raise ValueError('arguments have different shapes')"
        lines = [
            f"def {self.array_form.__name__}_rows({', '.join(names)}):",
            f"    n_row, slots = {like}.shape",
            *(line for check in checks for line in (f"    if {check}:", refuse)),
            f"    out = np.empty(({shape}))",
            "    for row in range(n_row):",
            "        for i in range(slots):",
            f"            {filled} = scalar({', '.join(taken)})",
            "    return out",
        ]
        space = {"np": np, "scalar": self.scalar, "__name__": self.array_form.__module__}
        exec("\n".join(lines), space)  # of the names of the arguments alone
        return compiled(space[f"{self.array_form.__name__}_rows"])

    def _with_kernels(self) -> types.FunctionType:
        """The body as a function of numbers: it calls kernels in place of the functions of this module."""
        body: Any = self.array_form
        names = dict(body.__globals__)
        for name in body.__code__.co_names:
            value = names.get(name)
            if isinstance(value, Formula):
                names[name] = value.scalar
            elif getattr(value, "__module__", None) == __name__:
                names[name] = _number_kernel(name)
        return types.FunctionType(body.__code__, names, body.__name__, body.__defaults__)


@cache
def _number_kernel(name: str) -> Any:
    """The function of this module of that name, as a kernel of numbers."""
    from dcgrid_env.core.compiled import compiled

    return compiled(_OF_NUMBERS[name], inner=True)


ROW_FUNCTIONS: dict[str, RowFunction] = {}
"""All functions of the imported modules that run as a kernel, by ``module:function``, that of a twin's kernel."""


def formula(body: Callable[..., Any] | None = None, *, like: str | None = None, views: Sequence[str] = ()) -> Any:
    """Declare a formula; see the module.

    Parameters
    ----------
    body
        Function of numbers, which is also correct for arrays. Its annotations state the shapes for ``like``: ``Array``
        is (row, slot), ``PerSlot`` (slot,), ``Array | None`` may be absent, and anything else is one value for all.
        The return annotation is ``Array`` or a tuple of several.
    like, views
        See ``RowFunction``. The kernel is a compiled loop over rows and slots.
    """

    def declare(body: Callable[..., Any]) -> Formula:
        declared = Formula(body, like, views)
        if like is not None:
            ROW_FUNCTIONS[f"{body.__module__}:{body.__name__}"] = declared
        return declared

    return declare if body is None else declare(body)


def compiled_as(kernel: str, like: str, views: Sequence[str] = ()) -> Callable[[Callable[..., Any]], RowFunction]:
    """Bind a function of arrays to its kernel, ``module:kernel``, which takes the same arguments.

    The kernel gives as many arrays. ``like`` and ``views`` are those of ``RowFunction``.
    """

    def bind(array_form: Callable[..., Any]) -> RowFunction:
        return ROW_FUNCTIONS.setdefault(kernel, Twins(array_form, kernel, like, views))

    return bind
