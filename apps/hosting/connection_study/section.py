"""A section of a report: answer, text, tables and pictures under a heading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dcgrid_env.apps.hosting.hosting import UNCONTROLLED
from dcgrid_env.core.text_table import Table


@dataclass(frozen=True)
class Section:
    """Content under one heading of a report; the order of the fields is that of the page."""

    name: str
    """Anchor of the section."""
    title: str
    answer: str = ""
    """One sentence with the result, which the top of the report repeats; empty for none."""
    paragraphs: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    pictures: tuple[tuple[str, bytes], ...] = ()
    """Description and PNG file of each picture."""


def figure_of(value: float, digits: int = 4) -> str:
    """A figure as text."""
    return f"{value:.{digits}g}"


def rise_or_fall(before: float, after: float) -> str:
    """The verb for a change from one figure to another."""
    return "rise" if after >= before else "fall"


def under(controller: str) -> str:
    """A controller's name in a sentence."""
    return "without control" if controller == UNCONTROLLED else f"under {controller}"


def sentences(parts: Sequence[str]) -> str:
    """Parts as sentences, each with a capital letter and one full stop."""
    return " ".join(f"{part[0].upper()}{part[1:].removesuffix('.')}." for part in parts)
