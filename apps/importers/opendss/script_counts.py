"""Whole numbers that an OpenDSS script gives: bounded before OpenDSS sizes its arrays by them.

OpenDSS allocates what ``windings`` or ``phases`` asks for, and ends with the process where it cannot.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence

from dcgrid_env.apps.importers.opendss.dss_words import Word

LARGEST_COUNT = 100
"""Largest number of phases, windings, conductors, steps, seasons and the like."""
LARGEST_NUMBER = 10_000_000
"""Largest value of the whole numbers that no small array is sized by."""
_NUMBERS = (
    "npts", "numharm", "class", "numcust", "inhibittime", "avgwindowlen", "dynreacavgwindowlen",
)  # fmt: skip
_SIGNED = ("tapnum", "deltadirection")
_WHOLE = re.compile(r"\s*[+-]?\d+(\.0*)?\s*", re.ASCII)


class Counts:
    """Which properties of each class are whole numbers, in OpenDSS's order.

    Parameters
    ----------
    schema
        OpenDSS's description of its classes, as JSON.
    """

    def __init__(self, schema: str) -> None:
        self._whole: dict[str, dict[str, bool]] = {}
        """Whether a property is one whole number, by class and name in lower case."""
        for kind in json.loads(schema)["classes"]:
            types = {one["name"].lower(): one["type"] for one in kind["properties"]}
            whole = {name: form in ("Integer", "IntegerOnStructArray") for name, form in types.items()}
            self._whole[kind["name"].lower()] = whole
        self._whole["circuit"] = self._whole["vsource"]

    def check(self, kind: str, words: Sequence[Word]) -> None:
        """Raise ValueError for a whole number out of bounds among the properties of one command.

        As in OpenDSS, a name may be abbreviated, and a value without a name belongs to the property that follows.
        """
        whole = self._whole.get(kind, {})
        order, place = list(whole), -1
        for word in words:
            name = word.name.lower()
            matching = [k for k, other in enumerate(order) if other.startswith(name)] if name else [place + 1]
            place = order.index(name) if name in whole else next(iter(matching), len(order))
            if place < len(order) and whole[order[place]]:
                _check(order[place], word.text)


def _check(name: str, text: str) -> None:
    high = LARGEST_NUMBER if name in _NUMBERS else LARGEST_COUNT
    low = -high if name in _SIGNED else 0
    if text.strip() and not (_WHOLE.fullmatch(text) and low <= float(text) <= high):
        raise ValueError(f"{name} is {text[:40]!r}; give a whole number from {low} to {high:,}")
