"""Answers that are kept on the object they are about, and so are freed with it.

A cache of the whole process that has scenarios or feeders among its keys keeps every one of them alive with its
matrices: who makes many, for random feeders or sweeps, runs out of memory. Here the object holds its own answers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

Owner = TypeVar("Owner")
Arguments = ParamSpec("Arguments")
Answer = TypeVar("Answer")

_KEPT = "_answers"
"""Attribute that holds an object's answers, by function and further arguments."""


def cached_on_owner(
    function: Callable[Concatenate[Owner, Arguments], Answer],
) -> Callable[Concatenate[Owner, Arguments], Answer]:
    """Keep the answers of a function on its first argument, a frozen object with a ``__dict__``.

    The function must depend on nothing but its arguments, and the further ones are positional and hashable.
    """

    @wraps(function)
    def answered(owner: Any, *rest: Any) -> Any:
        attributes = owner.__dict__
        if _KEPT not in attributes:
            attributes[_KEPT] = {}
        answers, key = attributes[_KEPT], (function, *rest)
        try:
            return answers[key]
        except KeyError:
            return answers.setdefault(key, function(owner, *rest))  # pyright: ignore[reportCallIssue]

    return answered  # pyright: ignore[reportReturnType]


def fields_alone(instance: Any) -> dict[str, Any]:
    """The fields of a dataclass instance without what is cached beside them, for pickling."""
    return {field.name: getattr(instance, field.name) for field in dataclasses.fields(instance)}
