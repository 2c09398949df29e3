"""What the written results share: tables of Markdown and wrapped paragraphs."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from typing import Any


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def columns_table(rows: Sequence[dict[str, Any]], columns: dict[str, tuple[str, str]]) -> str:
    """A table of records: heading -> (key, format)."""
    cells = [[format(row[key], how) for key, how in columns.values()] for row in rows]
    return table(list(columns), cells)


def wrapped(text: str) -> str:
    """A paragraph in lines of 120 columns."""
    return textwrap.fill(text, width=120, break_on_hyphens=False, break_long_words=False)
