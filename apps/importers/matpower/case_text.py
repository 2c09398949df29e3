"""A MATPOWER case file cut into MATLAB statements, without comments, each with its line; nothing is executed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from dcgrid_env.grid.topology import FeederError

_TOKEN = re.compile(
    r"""(?P<comment>[%\#][^\n]*)
    | (?P<continued>\.\.\.[^\n]*(?:\n|\Z))
    | (?P<transpose>(?<=[\w)\]}'.])')
    | (?P<text>'(?:[^'\n]|'')*' | "(?:[^"\n]|"")*")
    | (?P<end>\n)
    | (?P<open>[(\[{])
    | (?P<close>[)\]}])
    | (?P<stop>[;,])
    | (?P<plain>[^%\#'"\n\[\](){};,.]+ | \.)
    | (?P<bad>.)""",
    re.VERBOSE,
)
_PAIRS = {")": "(", "]": "[", "}": "{"}


@dataclass(frozen=True)
class Statement:
    """A MATLAB statement: the line that it begins on and its text without comments; line ends within brackets
    remain."""

    line: int
    text: str


def statements(file: str, text: str) -> Iterator[Statement]:
    """The statements of a file in their order.

    FeederError for brackets that do not match and strings that do not end, naming the line.
    """
    kept: list[str] = []
    first_line = line = 1
    depth: list[tuple[str, int]] = []
    for match in _TOKEN.finditer(_without_blocks(file, text)):
        kind, token = match.lastgroup, match.group()
        if kind == "bad":
            raise FeederError(f"{file}, line {line}: a text in quotes does not end")
        if kind == "open":
            depth.append((token, line))
        elif kind == "close" and (not depth or depth.pop()[0] != _PAIRS[token]):
            raise FeederError(f"{file}, line {line}: {token!r} closes no bracket")
        if kind in ("end", "stop") and not depth:
            if "".join(kept).strip():
                yield Statement(first_line, "".join(kept).strip())
            kept = []
        elif kind == "continued":
            kept.append(" ")
        elif kind != "comment" and (kept or token.strip()):
            if not kept:
                first_line = line
            kept.append(token)
        line += token.count("\n")
    if depth:
        raise FeederError(f"{file}, line {depth[-1][1]}: the bracket {depth[-1][0]!r} is not closed")
    if "".join(kept).strip():
        yield Statement(first_line, "".join(kept).strip())


def _without_blocks(file: str, text: str) -> str:
    """The text with block comments, from a line ``%{`` to a line ``%}``, as empty lines."""
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if not re.search(r"^\s*[%#]\{\s*$", text, re.MULTILINE):
        return text
    depth, lines = 0, []
    for line in text.split("\n"):
        word = line.strip()
        depth += word in ("%{", "#{")
        lines.append("" if depth else line)
        depth -= bool(depth and word in ("%}", "#}"))
    if depth:
        raise FeederError(f"{file}: a block comment (%{{) is not closed")
    return "\n".join(lines)
