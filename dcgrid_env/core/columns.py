"""Columns of a table on a terminal: headings fold at hyphens and spaces, and what does not fit goes below."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

BETWEEN = 2
"""Characters that a column takes in addition to its text, as ``Table.rich`` draws it; the table takes one more."""
NAME_SHARE = 0.4
"""Share of the terminal's width that the fixed columns may take together, where their words allow it."""
_PIECES = re.compile(r"\S+?(?:(?<=\w\w[-/])(?=\w)|(?=\s)|$)\s*")
"""Words, and parts of a name that end in a hyphen or a slash, each with the spaces behind it."""


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
