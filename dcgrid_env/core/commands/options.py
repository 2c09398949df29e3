"""Read options into a dataclass with tyro, and print help that fits the terminal and hides None defaults."""

from __future__ import annotations

import dataclasses
import re
import shutil
import sys
import textwrap
from collections.abc import Sequence
from contextlib import redirect_stdout
from typing import Annotated, Any, TextIO, Union, cast, get_args, get_origin, get_type_hints

import docstring_parser
import tyro
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

_REGISTRY = ConstructorRegistry()
_ABOUT = "{about}"
"""Placeholder for the description; the output replaces it by the text."""


def parsed(kind: type[Any], words: Sequence[str], prog: str, about: str, default: Any = None) -> Any:
    """Parse the words of a command line into a dataclass.

    Raises SystemExit if a word is invalid, after tyro's message, and after the help.

    Parameters
    ----------
    kind
        The dataclass; the docstrings of its fields are the help of the options.
    words
        Words that follow ``prog``.
    prog, about
        Command as typed, and its description.
    default
        Instance with the defaults; the defaults of the class if None.
    """
    default = tyro.MISSING_NONPROP if default is None else default
    with redirect_stdout(cast("TextIO", _Output(sys.stdout, about))):
        return tyro.cli(kind, args=words, prog=prog, description=_ABOUT, default=default, registry=_REGISTRY)


class _Output:
    """Standard output that wraps usage and description to the width of the terminal, which tyro does not."""

    def __init__(self, out: TextIO, about: str):
        self._out, self._about = out, about

    def write(self, text: str) -> int:
        """Write a line of tyro's output."""
        width = max(40, shutil.get_terminal_size().columns)
        if "usage:" in text[:12]:  # the word is in bold on a terminal
            text = textwrap.fill(text, width, subsequent_indent=" " * 7)
        elif text == _ABOUT:
            text = "\n\n".join(textwrap.fill(_plain(part), width) for part in self._about.split("\n\n"))
        return self._out.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._out, name)


@_REGISTRY.struct_rule
def _options(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Return the options of a dataclass, with their help."""
    if not dataclasses.is_dataclass(info.type):
        return None
    hints, texts, fields = get_type_hints(info.type, include_extras=True), helps(info.type), []
    for field in dataclasses.fields(info.type):
        default = _default(field, info.default)
        hint = _described(hints[field.name], field, required=default is tyro.MISSING_NONPROP)
        fields.append(StructFieldSpec(field.name, hint, default, texts.get(field.name)))
    return StructConstructorSpec(info.type, tuple(fields))


def helps(kind: type[Any]) -> dict[str, str]:
    """Return the docstrings of the fields by name, each as one paragraph."""
    documented = (docstring_parser.parse_from_object(base) for base in reversed(kind.__mro__) if base is not object)
    return {field.arg_name: _plain(field.description or "") for text in documented for field in text.params}


def _plain(text: str) -> str:
    """Return a paragraph without line breaks and reStructuredText markup."""
    joined = " ".join(text.split())
    return re.sub(r":[a-z]+:`~?(.*?)`", r"\1", joined).replace("``", "`")


def _default(field: dataclasses.Field[Any], instance: Any) -> Any:
    if dataclasses.is_dataclass(instance):
        return getattr(instance, field.name)
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return tyro.MISSING_NONPROP if field.default is dataclasses.MISSING else field.default


def _described(hint: Any, field: dataclasses.Field[Any], *, required: bool) -> Any:
    """Return a field's type for tyro: no None in its placeholder, and its default shown only if it is a value."""
    inner, *more = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    metavar = field.name.replace("_", "-").upper() if tyro.conf.Positional in more else _placeholder(inner)
    if get_args(inner)[1:] == (...,):
        metavar = f"{metavar} ..."
    if tyro.conf.Positional in more and not required:
        metavar = f"[{metavar}]"
    return Annotated[inner, tyro.conf.arg(metavar=metavar, help_behavior_hint=_default_shown), *more]


def _placeholder(kind: Any) -> str | None:
    """Return the placeholder of a value, or of one item of a tuple of any length; None for tyro's default."""
    parts = tuple(part for part in get_args(kind) if part is not type(None))
    if type(None) not in get_args(kind) and parts[1:] != (...,):
        return None
    value: Any = parts[0] if parts[1:] == (...,) else Union[parts]  # noqa: UP007
    spec = ConstructorRegistry.get_primitive_spec(PrimitiveTypeInfo.make(value, set()))
    return spec.metavar if isinstance(spec, PrimitiveConstructorSpec) else None


def _default_shown(value: str) -> str:
    return "" if value in ("", "''", "None") else f"(default: {value})"
