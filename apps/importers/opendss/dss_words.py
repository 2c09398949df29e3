"""One line of an OpenDSS script as words, read by OpenDSS's rules and rewritten in an unambiguous form.

Words are separated by blanks and commas, and ``name=value`` is one word. Quotes, parentheses, brackets or braces may
enclose a value, up to the first that closes; within a word they are letters like others, as in ``Line.l(r:a-b)``. Text
that OpenDSS and this file could read differently is refused: nested brackets of one kind, control characters, and
OpenDSS's variables ``@name``.
"""

from __future__ import annotations

import re
from typing import NamedTuple

CLOSING = {'"': '"', "'": "'", "(": ")", "[": "]", "{": "}"}
_BLANK = " \t"
_VARIABLE = re.compile(r"""(^|[\s,=|("'\[{])@""")
"""Text that names a variable, alone or in a list; within a name ``@`` is a letter."""


class Word(NamedTuple):
    """A word of a line."""

    name: str
    """Text before the equals sign; empty if there is none."""
    text: str
    """The value without its quotes."""
    quote: str = ""
    """Opening quote or bracket around the value; empty if there is none."""

    def __str__(self) -> str:
        text = f"{self.quote}{self.text}{CLOSING[self.quote]}" if self.quote else self.text
        return f"{self.name}={text}" if self.name else text


def words_of(line: str) -> list[Word]:
    """Split a line without its comment into words.

    Raises
    ------
    ValueError
        Saying what cannot be read; file and line are the caller's to add.
    """
    if any((ord(character) < 32 and character != "\t") or ord(character) == 127 for character in line):
        raise ValueError("a control character; delete it")
    words: list[Word] = []
    index = 0
    while (index := _skipped(line, index, _BLANK + ",")) < len(line) and not _is_comment(line, index):
        if line[index] == "=":
            raise ValueError("= without a name before it; write name=value")
        text, quote, index = _value(line, index)
        after = _skipped(line, index, _BLANK)
        if after < len(line) and line[after] == "=":
            if quote:
                raise ValueError(f"the name {text!r} stands in quotes; write it without")
            name, index = text, _skipped(line, after + 1, _BLANK)
            empty = index >= len(line) or line[index] in ",=" or _is_comment(line, index)
            text, quote, index = ("", '"', index) if empty else _value(line, index)
            words.append(Word(name, text, quote))
        else:
            words.append(Word("", text, quote))
    for word in words:
        if _VARIABLE.search(word.name) or _VARIABLE.search(word.text):
            raise ValueError(f"{str(word)!r} may name a variable of OpenDSS; write what it stands for")
    return words


def quoted(text: str) -> Word:
    """A value in the first kind of quotes that it does not contain."""
    quote = next((one for one, closing in CLOSING.items() if one not in text and closing not in text), "")
    return Word("", text, quote)


def _skipped(line: str, index: int, characters: str) -> int:
    while index < len(line) and line[index] in characters:
        index += 1
    return index


def _is_comment(line: str, index: int) -> bool:
    return line[index] == "!" or line.startswith("//", index)


def _value(line: str, index: int) -> tuple[str, str, int]:
    """A value that begins at a place, its quote and the place behind it."""
    quote = line[index]
    if quote not in CLOSING:
        end = index
        while end < len(line) and line[end] not in _BLANK + ",=" and not _is_comment(line, end):
            end += 1
        return line[index:end], "", end
    end = line.find(CLOSING[quote], index + 1)
    if end < 0:
        raise ValueError(f"{quote} is not closed on its line")
    text = line[index + 1 : end]
    if quote in text:
        raise ValueError(f"{quote} stands within {quote} {CLOSING[quote]}; use brackets of another kind inside")
    return text, quote, end + 1
