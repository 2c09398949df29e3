"""Cached results that are stored on the object they belong to, and are freed with it.

A process-wide cache with scenarios or feeders as keys would keep all of them and their matrices in memory. A program
that creates many, for random feeders or sweeps, would run out of memory.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import wraps
from inspect import signature
from itertools import count
from typing import Any, Concatenate, ParamSpec, TypeVar

Owner = TypeVar("Owner")
Arguments = ParamSpec("Arguments")
Answer = TypeVar("Answer")

_NUMBER = count()


def cached_on_owner(
    function: Callable[Concatenate[Owner, Arguments], Answer],
) -> Callable[Concatenate[Owner, Arguments], Answer]:
    """Keep the answers of a function on its first argument, a frozen object with a ``__dict__``.

    The function must depend on nothing but its arguments, and the further ones are positional and hashable.
    """
    key = f"_{function.__name__}_{next(_NUMBER)}"  # unlike that of another function of this name
    compute: Any = function

    def one(owner: object) -> Any:
        store = owner.__dict__
        if key in store:
            return store[key]
        return store.setdefault(key, compute(owner))

    def several(owner: object, *rest: Any) -> Any:
        store = owner.__dict__
        answers = store[key] if key in store else store.setdefault(key, {})
        try:
            return answers[rest]
        except KeyError:
            return answers.setdefault(rest, compute(owner, *rest))

    return wraps(function)(one if len(signature(function).parameters) == 1 else several)  # pyright: ignore


def fields_alone(instance: Any) -> dict[str, Any]:
    """Return the fields of a dataclass instance without cached results, for pickling."""
    return {field.name: getattr(instance, field.name) for field in dataclasses.fields(instance)}


class PickledByFields:
    """Mixed into frozen dataclasses that keep answers on themselves: a pickle holds their fields alone."""

    def __getstate__(self) -> dict[str, Any]:
        return fields_alone(self)

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, value)
