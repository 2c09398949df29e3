"""A section of a report: text, tables and pictures under a heading."""

from __future__ import annotations

from dataclasses import dataclass

from dcgrid_env.baselines.benchmark.benchmark_tables import Table


@dataclass(frozen=True)
class Section:
    """What a report says under one heading, in this order: paragraphs, tables, pictures."""

    name: str
    """Anchor of the section."""
    title: str
    paragraphs: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    pictures: tuple[tuple[str, bytes], ...] = ()
    """Description and PNG file of each picture."""


def figure_of(value: float, digits: int = 4) -> str:
    """A figure as text."""
    return f"{value:.{digits}g}"
