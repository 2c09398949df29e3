"""Keywords of GridLAB-D's enumerations and sets, and the numbers that a file may have in their place.

The numbers are those of GridLAB-D's headers; the tests compare them with the program.
"""

from __future__ import annotations

import re

_STATE = {"OPEN": 0, "CLOSED": 1}
ENUMERATIONS: dict[str, dict[str, dict[str, int]]] = {
    "node": {"bustype": {"PQ": 0, "PV": 1, "SWING": 2, "SWING_PQ": 3}},
    "link": {"status": _STATE},
    "switch": {f"phase_{phase}_state": _STATE for phase in "ABC"} | {"operating_mode": {"INDIVIDUAL": 0, "BANKED": 1}},
    "fuse": {f"phase_{phase}_status": {"BLOWN": 0, "GOOD": 1} for phase in "ABC"},
    "capacitor": {
        **{f"switch{phase}": _STATE for phase in "ABC"},
        "control": {"MANUAL": 0, "VAR": 1, "VOLT": 2, "VARVOLT": 3, "CURRENT": 4},
        "control_level": {"BANK": 0, "INDIVIDUAL": 1},
        "service_status": {"OUT_OF_SERVICE": 0, "IN_SERVICE": 1},
    },
    "regulator_configuration": {
        "connect_type": {
            "WYE_WYE": 1, "OPEN_DELTA_ABBC": 2, "OPEN_DELTA_BCAC": 3, "OPEN_DELTA_CABA": 4, "CLOSED_DELTA": 5,
        },
        "Control": {"MANUAL": 1, "OUTPUT_VOLTAGE": 2, "REMOTE_NODE": 3, "LINE_DROP_COMP": 4},
        "control_level": {"INDIVIDUAL": 1, "BANK": 2},
        "Type": {"A": 1, "B": 2},
    },
    "transformer_configuration": {
        "connect_type": {
            "WYE_WYE": 1, "DELTA_DELTA": 2, "DELTA_GWYE": 3, "SINGLE_PHASE": 4, "SINGLE_PHASE_CENTER_TAPPED": 5,
        },
    },
}  # fmt: skip
"""Number of each keyword, by class and property."""
PHASES = {"A": 0x001, "B": 0x002, "C": 0x004, "N": 0x008, "D": 0x100, "S": 0x070, "G": 0x080}
"""Bits of the letters of a set of phases."""
_CODE = re.compile(r"0[xX][0-9a-fA-F]{1,8}|[0-9]{1,10}")


def keyword(text: str, words: dict[str, int]) -> str:
    """Return the keyword that a text means; ValueError for none."""
    if _CODE.fullmatch(text):
        word_found = next((word for word, number in words.items() if number == _number(text)), None)
    else:
        word_found = text.upper() if text.upper() in words else None
    if word_found is None:
        raise ValueError(f"must be one of {', '.join(f'{word} ({number})' for word, number in words.items())}")
    return word_found


def phase_letters(text: str) -> str:
    """Return the letters of a set of phases, in the order of ``PHASES``; ValueError for other letters."""
    if _CODE.fullmatch(text):
        number = _number(text)
        letters = {letter for letter, bits in PHASES.items() if number & bits}
        if number & ~sum(PHASES.values()):
            letters = set()
    else:
        letters = set(text.upper()) - set("| ")
    if not letters or letters - set(PHASES):
        raise ValueError(f"must be letters among {', '.join(PHASES)}, or the sum of their numbers")
    return "".join(letter for letter in PHASES if letter in letters)


def _number(text: str) -> int:
    return int(text, 16 if text[:2] in ("0x", "0X") else 10)
