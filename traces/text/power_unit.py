"""Units of power in the headers of files."""

import re
from collections.abc import Sequence

from dcgrid_env.traces.checks import TraceError

KW_PER_UNIT = {"W": 1e-3, "kW": 1.0, "MW": 1e3, "mW": 1e-6}
# Spellings in small letters that can only mean one unit; "mw" could mean two.
_SPELLINGS = {"w": "W", "watt": "W", "watts": "W", "kw": "kW", "kilowatt": "kW", "kilowatts": "kW"}
_SPELLINGS |= {"megawatt": "MW", "megawatts": "MW", "milliwatt": "mW", "milliwatts": "mW"}
_OTHERS = frozenset(["hp", "ps", "btu", "gw", "uw", "va", "kva", "mva", "%"])
_ENERGY_UNITS = frozenset(["j", "kj", "mj", "gj", "uj", "wh", "kwh", "mwh", "gwh", "ws", "kws"])
_ENERGY_WORD = re.compile(r"(?:[a-z]*joules?|(?:kilo|mega)?watt-?hours?|[kmg]?wh|energy[a-z]*)")
_POWER_WORDS = ("power", "load", "draw", "watt", "pwr", "consumption")
_OTHER_WORDS = (
    "time", "date", "elapsed", "temp", "util", "clock", "clk", "freq", "fan", "mem", "humid", "volt", "current", "amp",
    "duration", "count", "percent", "pct", "emission", "co2", "cost", "price", "speed", "throughput",
)  # fmt: skip
"""Begins of words that name another quantity than power."""
_LIMITS = (
    "limit", "limits", "cap", "max", "maximum", "min", "minimum", "rated", "rating", "tdp", "budget", "threshold",
    "nominal", "target", "setpoint", "forecast",
)  # fmt: skip
"""Words of columns that contain no readings of the power, although their unit is one of power."""
_SUMS = frozenset(["total", "sum", "overall", "combined", "aggregate"])
_STATISTICS = frozenset(["average", "avg", "mean", "instant", "instantaneous", "current"])
_SEPARATORS = re.compile(r"[\s_.,:/-]+")


def require_unit(name: str, unit: str | None) -> None:
    """Raise TraceError, naming the file `name`, if `unit` is neither None nor known."""
    if unit is not None and unit not in KW_PER_UNIT:
        raise TraceError(f"{name}: unit {unit!r} is unknown; choose one of {', '.join(KW_PER_UNIT)}")


def bracketed(header: str) -> tuple[str, bool]:
    """Return the text in brackets at the end of a column's name ("" without them), and whether they are square."""
    match = re.search(r"\[([^\[\]]*)\]$|\(([^()]*)\)$", header.strip())
    if match is None:
        return "", False
    return (match[1] or match[2] or "").strip(), match[1] is not None


def last_word(header: str) -> str:
    """Return the last word of a column's name before any brackets, split at `_`, `/`, a space etc.: `kW` of `P/kW`."""
    return _SEPARATORS.split(re.sub(r"\s*(?:\[[^\[\]]*\]|\([^()]*\))$", "", header.strip()))[-1]


def word_unit(word: str) -> str | None:
    """Return the unit of power that a word spells, with its usual sign; None for another word."""
    return word if word in KW_PER_UNIT else _SPELLINGS.get(word.casefold())


def other_quantity(header: str) -> str | None:
    """Return the quantity that a column or metric names if it is not power: "energy" or a word such as `temperature`.

    `energy_j`, `E [kWh]` and `joules_total` are energy. A limit or extreme such as `power_limit_w` is no power. Other
    names that contain power or its unit are power.
    """
    inside, last = bracketed(header)[0], last_word(header)
    if {inside.casefold(), last.casefold()} & _ENERGY_UNITS:
        return "energy"
    words = _words(header)
    pairs = zip(["", *words], words, strict=False)
    limit = next((word for before, word in pairs if word in _LIMITS and not (word == "min" and before.isdigit())), None)
    if limit is not None:
        return limit
    if any(map(word_unit, (inside, last))):
        return None
    if any(map(_ENERGY_WORD.fullmatch, words)):
        return "energy"
    if any(word.startswith(_POWER_WORDS) for word in words):
        return None
    return next((word for word in words if word.startswith(_OTHER_WORDS)), None)


def _words(header: str) -> list[str]:
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z][a-z])", " ", header)
    return re.split(r"[\s_.,:/()\[\]-]+", spaced.casefold())


def require_summable(where: str, headers: Sequence[str]) -> None:
    """Raise TraceError if the sum of the columns would count power twice, as that of `gpu0_w`, `gpu1_w` and `total_w`.

    Two statistics of a power, such as `power_average_w` and `power_instant_w`, are counted twice too.
    """
    sums = [header for header in headers if _SUMS.intersection(_words(header))]
    first_headers: dict[tuple[str, ...], str] = {}
    fault = None
    if sums and len(sums) < len(headers):
        fault = f"{sums[0]!r} names a sum, and there are other columns of power"
    for header in headers:
        words = _words(header)
        first = first_headers.setdefault(tuple(word for word in words if word not in _STATISTICS), header)
        if first != header:
            fault = f"{first!r} and {header!r} are two figures of one power"
    if fault:
        raise TraceError(f"{where}: {fault}; name the columns to sum with power_columns=")


def require_power(where: str, header: str, remedy: str) -> None:
    """Raise TraceError if a name is one of energy, which is not power, whatever unit the caller gives."""
    if other_quantity(header) == "energy":
        raise TraceError(f"{where}: {header!r} is energy, not power; {remedy}")


def column_unit(where: str, header: str, unit: str | None) -> str | None:
    """Return the unit of a column from its name or the caller's `unit`; None if neither contains it.

    A name gives it in brackets at its end, or as its last word before them: `power (kW)`, `site [MW]`, `gpu0_w`,
    `P/kW`, `load kW`. Square brackets hold a unit unless they hold a number (`gpu[0]`); round ones may hold anything.

    Parameters
    ----------
    where : text that begins a message, for example "file.csv, line 1".
    header : the column's name, for example `power.draw [W]`.
    unit : what the caller gave.

    Raises
    ------
    TraceError
        If the name holds two units, another unit than the given one, or, where none is given, an unknown one or `mw`.
    """
    inside, square = bracketed(header)
    words = [inside, last_word(header)]
    stated = sorted({spelled for word in words if (spelled := word_unit(word)) is not None})
    either = any(word.casefold() == "mw" and word not in KW_PER_UNIT for word in words)
    if either and not {"mW", "MW"} & {*stated, unit}:
        raise TraceError(
            f"{where}: {header!r} may mean milliwatt or megawatt; pass unit='mW' or unit='MW', or write mW or MW"
        )
    if square and not word_unit(inside) and not inside.isdigit():
        others = [inside]
    else:
        others = [word for word in words if word.casefold() in _OTHERS]
    if unit is None and others:
        raise TraceError(
            f"{where}: {header!r} names the unit {others[0]!r}, which is none of {', '.join(KW_PER_UNIT)}; "
            "convert the column, or pass unit= if it is one of these all the same"
        )
    if len(stated) > 1:
        raise TraceError(f"{where}: {header!r} names the units {' and '.join(stated)}; rename the column")
    if stated and unit not in (None, stated[0]):
        raise TraceError(
            f"{where}: {header!r} names the unit {stated[0]}, but unit = {unit!r} is given; leave unit out, or rename "
            "the column if its name is wrong"
        )
    return stated[0] if stated else unit
