"""Numbers of GridLAB-D's .glm files: complex values and units."""

from __future__ import annotations

import cmath
import math
import re

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_REAL = re.compile(rf"(?P<first>{_NUMBER})(?P<unit>.*)")
_COMPLEX = re.compile(rf"(?P<first>{_NUMBER})(?P<second>{_NUMBER})?(?P<form>[ijdr])(?P<unit>.*)")
_FEET = {
    "ft": 1.0, "in": 1.0 / 12.0, "yd": 3.0, "mile": 5280.0, "mi": 5280.0, "m": 1.0 / 0.3048, "cm": 0.01 / 0.3048,
    "mm": 0.001 / 0.3048, "km": 1000.0 / 0.3048,
}  # fmt: skip
_VOLT_AMPERES = {
    f"{prefix}{unit}": factor
    for prefix, factor in {"": 1.0, "k": 1e3, "M": 1e6}.items()
    for unit in ("VA", "W", "VAr", "VAR", "var")
}
UNITS = {
    "length": _FEET,
    "diameter": {unit: 12.0 * feet for unit, feet in _FEET.items()},
    "impedance per length": {
        f"{ohm}/{unit}": 5280.0 / _FEET[unit] for ohm in ("Ohm", "ohm") for unit in ("mile", "mi", "km", "m", "ft")
    },
    "capacitance per length": {f"nF/{unit}": 5280.0 / _FEET[unit] for unit in ("mile", "mi", "km", "m", "ft")},
    "voltage": {"V": 1.0, "kV": 1e3, "MV": 1e6},
    "current": {"A": 1.0, "kA": 1e3},
    "power": _VOLT_AMPERES,
    "rating": {unit: factor / 1e3 for unit, factor in _VOLT_AMPERES.items()},
    "impedance": {"Ohm": 1.0, "ohm": 1.0, "kOhm": 1e3},
    "time": {"s": 1.0, "min": 60.0, "h": 3600.0},
    "frequency": {"Hz": 1.0},
    "ratio": {"pu": 1.0, "unit": 1.0, "%": 0.01},
    "plain number": {"pu": 1.0},
}  # fmt: skip
"""Factor of each unit, by quantity. GridLAB-D's units, which have the factor 1, apply to values without a unit.

They are ft, in (diameter), Ohm/mile, nF/mile, V, A, VA, kVA (rating), Ohm, s and Hz.
"""


def number(text: str, quantity: str) -> complex:
    """Return a value in GridLAB-D's unit of a quantity.

    Parameters
    ----------
    text
        Value as a file has it, such as ``"1500 ft"``, ``"-1200.8886-2080.000j"`` or ``"480+120.2d"``, whose second part
        is an angle in degrees (``d``) or radians (``r``).
    quantity
        Key of ``UNITS``.

    Raises
    ------
    ValueError
        If the text is not a finite number, or if its unit does not belong to the quantity.
    """
    compact, factors = "".join(text.split()), UNITS[quantity]
    match = _REAL.fullmatch(compact)
    if match is None:
        raise ValueError("must be a number, such as 7200, 1500 ft or 100+50j")
    value = complex(float(match["first"]))
    if (unit := match["unit"]) not in ("", *factors) and (match := _COMPLEX.fullmatch(compact)):
        value, unit = _complex(float(match["first"]), match["second"], match["form"]), match["unit"]
    if unit not in ("", *factors):
        raise ValueError(f"must be in {', '.join(factors)}")
    value *= factors[unit] if unit else 1.0
    if not (math.isfinite(value.real) and math.isfinite(value.imag)):
        raise ValueError("must be a finite number")
    return value


def _complex(first: float, second: str | None, form: str) -> complex:
    if form in ("i", "j"):
        return complex(first, float(second)) if second else complex(0.0, first)
    angle = float(second or 0.0)
    return cmath.rect(first, math.radians(angle) if form == "d" else angle)
