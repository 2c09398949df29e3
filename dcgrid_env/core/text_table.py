"""Table of text: Markdown, HTML and the terminal, where headings fold and columns that do not fit go below."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from rich.console import Group

NONE = "–"
"""Text of a cell without a figure."""
BETWEEN = 2
"""Characters that a column takes in addition to its text, as ``Table.rich`` draws it; the table takes one more."""
NAME_SHARE = 0.4
"""Share of the terminal's width that the fixed columns may take together, where their words allow it."""
_PIECES = re.compile(r"\S+?(?:(?<=\w\w[-/])(?=\w)|(?=\s)|$)\s*")
"""Words, and parts of a name that end in a hyphen or a slash, each with the spaces behind it."""


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


class Part(NamedTuple):
    """Columns that are shown side by side."""

    columns: tuple[int, ...]
    widths: tuple[int, ...]
    """Characters of each."""


def folded(text: str, width: int) -> str:
    """Text in lines of at most that many characters, no word nor part of a hyphenated name broken (though longer)."""
    lines = [""]
    for piece in _PIECES.findall(text):
        if lines[-1] and len(lines[-1]) + len(piece.rstrip()) > width:
            lines[-1] = lines[-1].rstrip()
            lines.append("")
        lines[-1] += piece
    return "\n".join(lines).rstrip()


def longest_piece(text: str) -> int:
    """Characters that the longest part of a text takes which ``folded`` leaves whole."""
    return max((len(piece.rstrip()) for piece in _PIECES.findall(text)), default=0)


def fit(header: Sequence[str], rows: Sequence[Sequence[str]], width: int, fixed: int = 1) -> list[Part]:
    """Parts of a table that fit a terminal.

    Parameters
    ----------
    header, rows
        The table's text.
    width
        How many characters a line of the terminal takes.
    fixed
        Number of first columns that name the rows. Every part contains them, and their cells fold like headings.

    Returns
    -------
    list
        The parts, each of at least one column besides; headings are unfolded where there is room.
    """
    columns = [(name, *(row[i] for row in rows)) for i, name in enumerate(header)]
    widest = [max(map(len, column)) for column in columns]
    least = [max(map(longest_piece, column)) for column in columns[:fixed]]
    least += [max(longest_piece(column[0]), *map(len, column[1:]), 0) for column in columns[fixed:]]
    names = range(fixed)
    room = int(NAME_SHARE * width) - sum(least[i] for i in names)
    for i in names:
        wider = min(max(room, 0), widest[i] - least[i])
        least[i] += wider
        room -= wider
    left = width - 1 - sum(least[i] + BETWEEN for i in names)
    parts: list[list[int]] = [[]]
    for i in range(fixed, len(columns)):
        if parts[-1] and sum(least[k] + BETWEEN for k in (*parts[-1], i)) > left:
            parts.append([])
        parts[-1].append(i)
    return [_widened(part, fixed, least, widest, left) for part in parts]


def _widened(part: Sequence[int], fixed: int, least: Sequence[int], widest: Sequence[int], left: int) -> Part:
    """The part with the room that is left given to its headings, from the left."""
    spare, widths = left - sum(least[i] + BETWEEN for i in part), list(least[:fixed])
    for i in part:
        wider = min(max(spare, 0), widest[i] - least[i])
        widths.append(least[i] + wider)
        spare -= wider
    return Part((*range(fixed), *part), tuple(widths))
