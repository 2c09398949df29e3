"""Table of text: Markdown, HTML and the terminal."""

from __future__ import annotations

import html
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dcgrid_env.core.columns import fit, folded

if TYPE_CHECKING:
    from rich.console import Group

NONE = "–"
"""Text of a cell without a figure."""


@dataclass(frozen=True)
class Table:
    """Rows of text under a header; the first column is the row's name, the rest are figures."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()

    def markdown(self) -> str:
        """The table in Markdown; text of users cannot break the table."""
        ruled = "|".join(["---", *["---:"] * (len(self.header) - 1)])
        lines = [_row(map(_cell, self.header)), f"|{ruled}|", *(_row(map(_cell, row)) for row in self.rows)]
        notes = "".join(f"\n\n{_cell(note)}" for note in self.notes)
        return f"## {_cell(self.title)}\n\n" + "\n".join(lines) + notes + "\n"

    def html(self) -> str:
        """The table in HTML, all text escaped."""
        head = "".join(f"<th>{html.escape(text)}</th>" for text in self.header)
        body = "".join(
            f"<tr><th>{html.escape(row[0])}</th>" + "".join(map(_td, row[1:])) + "</tr>" for row in self.rows
        )
        notes = "".join(f"<p class=note>{html.escape(note)}</p>" for note in self.notes)
        return f"<div class=wide><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>{notes}"

    def rich(self, width: int, fixed: int = 1) -> Group:
        """The table on a terminal of so many characters, in parts where it is wider.

        The first ``fixed`` columns contain the row's name and are repeated in every part.
        """
        from rich import box
        from rich.console import Group
        from rich.table import Table as RichTable
        from rich.text import Text

        header, shown = list(self.header), []
        for part in fit(header, self.rows, width, fixed):
            table = RichTable(title_justify="left", header_style="bold", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
            table.title = None if shown else Text(self.title)
            for i, wide in zip(part.columns, part.widths, strict=True):
                side = "right" if i >= fixed else "left"
                table.add_column(Text(folded(header[i], wide)), justify=side, overflow="fold", width=wide)
            for row in self.rows:
                cells = zip(part.columns, part.widths, strict=True)
                table.add_row(*(Text(folded(row[i], wide) if i < fixed else row[i]) for i, wide in cells))
            shown.append(table)
        return Group(*shown)


def _row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _cell(text: str) -> str:
    """Text of a user's as Markdown shows it literally."""
    for sign in "\\|`*_<>[]$~&":
        text = text.replace(sign, "\\" + sign)
    return " ".join(text.splitlines())


def _td(text: str) -> str:
    """A figure's interval goes below it, smaller."""
    value, bracket, interval = text.partition(" (")
    return f"<td>{html.escape(value)}" + (f"<br><small>({html.escape(interval)}</small>" if bracket else "") + "</td>"
