"""Cells of text files: numbers, and texts that mean a missing reading."""

import re

MISSING = r"(?i:\[[^\[\]]*\]|#?n/?a|nan|none|null|nil|-+|err!?|undefined|not supported|not available|unknown error|)"
"""Pattern of a cell without a reading, as meters and their exports write it: `[N/A]`, `ERR!`, `null`, nothing."""
_MISSING = re.compile(rf"\s*{MISSING}\s*")


def is_missing(text: str) -> bool:
    """Return whether a cell contains no reading."""
    return _MISSING.fullmatch(text) is not None


def is_number(text: str) -> bool:
    """Return whether a cell is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def reading(text: object) -> float:
    """Return the number in a cell or JSON value, NaN for a missing reading; raise ValueError for another text."""
    if text is None:
        return float("nan")
    if isinstance(text, str) and is_missing(text):
        return float("nan")
    return float(text)  # pyright: ignore[reportArgumentType]


def not_a_number(text: str) -> str:
    """Return what a message says of a cell that should contain a number."""
    remedy = "repair or remove the line"
    if "," in text:
        remedy = "write numbers with a decimal point and without thousands separators"
    return f"is {text.strip()[:40]!r}, not a number; {remedy}"
