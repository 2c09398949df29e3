"""Read lists of names from the command line."""

from __future__ import annotations

_OPEN, _CLOSED, _QUOTES = "([{", ")]}", "'\""


def split_names(text: str) -> list[str]:
    """Split names at commas, in order and without duplicates; a comma within brackets is part of a name.

    Raises ValueError if a bracket is not closed.
    """
    names, depth, quote = [""], 0, ""
    for sign in text:
        if quote or (depth and sign in _QUOTES):
            quote = "" if sign == quote else quote or sign
        elif sign in _OPEN:
            depth += 1
        elif sign in _CLOSED:
            depth = max(0, depth - 1)
        if sign == "," and not depth:
            names.append("")
        else:
            names[-1] += sign
    if depth:
        raise ValueError(f"names: brackets must be closed, got {text!r}; close the bracket")
    return list(dict.fromkeys(name.strip() for name in names if name.strip()))
