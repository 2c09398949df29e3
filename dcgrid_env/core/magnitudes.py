"""Largest and smallest sizes of physical quantities: beyond them a figure is in another unit or damaged.

The unit at the end of a field's name says which limit applies (``p_kw``, ``r_ohm``).
"""

from __future__ import annotations

LARGEST = {
    "kw": 1e8,
    "kvar": 1e8,
    "kva": 1e8,
    "mva": 1e6,
    "kv": 1e4,
    "ln": 1e4,
    "from": 1e4,
    "to": 1e4,
    "v": 1e7,
    "a": 1e8,
    "ohm": 1e9,
    "us": 1e9,
    "pu": 1e3,
    "percent": 1e6,
    "ppm": 1e9,
    "m": 1e8,
    "hz": 1e3,
    "s": 1e9,
    "deg": 1e5,
}
"""Largest size by unit; ``ln``, ``from`` and ``to`` end the names of voltages in kV."""
LARGEST_OF_ANY = 1e12
SMALLEST = 1e-100
"""A number other than 0 that is nearer to 0 is refused, because its square or inverse cannot be computed."""


def wrong_magnitude(field: str, value: float) -> str | None:
    """Return what is allowed where no feeder has a finite number of this size in a field; None where it may be."""
    largest = LARGEST.get(field.rpartition("_")[2], LARGEST_OF_ANY)
    if abs(value) > largest:
        return f"no feeder has more than {largest:g}; check the unit"
    if 0 < abs(value) < SMALLEST:
        return f"give at least {SMALLEST:g} in size, or 0 if the field may be 0"
    return None
