"""Format Markdown tables and wrapped paragraphs."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from typing import Any


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def columns_table(rows: Sequence[dict[str, Any]], columns: dict[str, tuple[str, str]]) -> str:
    """Return a table of records; ``columns`` maps a heading to a key and a format."""
    cells = [[format(row[key], how) for key, how in columns.values()] for row in rows]
    return table(list(columns), cells)


def wrapped(text: str, indent: str = "") -> str:
    """Wrap a paragraph at 120 columns, further lines with an indent."""
    return textwrap.fill(text, width=120, subsequent_indent=indent, break_on_hyphens=False, break_long_words=False)
