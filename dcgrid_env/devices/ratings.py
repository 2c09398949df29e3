"""Ratings of the devices of a scenario, as arrays over its slots.

| device | field | unit | valid |
|---|---|---|---|
| data centre | p_rated_kw | kW | > 0 |
| | p_idle_kw | kW | 0 .. p_rated_kw |
| | f_min_mhz, f_max_mhz | MHz | 0 < f_min <= f_max |
| | s_rated_kva | kVA | >= p_rated_kw |
| | q_max_kvar | kvar | 0 < q_max <= s_rated_kva |
| inverter | s_rated_kva | kVA | > 0 |
| storage | p_rated_kw | kW | > 0 |
| | energy_kwh | kWh | > 0 |
| | s_rated_kva | kVA | None, or >= p_rated_kw |
| | others | | the table of ``storage.storages`` |
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.checked import finite, is_number, refuse

Rating = float | tuple[float, ...]
"""One number for all devices of a kind, or one for each."""
SMALLEST_RATING = 1e-9
LARGEST_RATING = 1e9
"""Largest rating of a device, kW or kVA: a thousand gigawatts."""


class DataCenterParams(NamedTuple):
    """Ratings of the data centres, each of shape (n_dc,)."""

    p_rated_kw: Array
    p_idle_kw: Array
    p_dynamic_kw: Array
    """Rating less idle draw, kW."""
    f_min_mhz: Array
    f_max_mhz: Array
    s_rated_kva: Array
    q_max_kvar: Array


class InverterParams(NamedTuple):
    """Ratings of the inverters, each of shape (n_inv,)."""

    s_rated_kva: Array


def check_rating(owner: object, name: str, n: int) -> None:
    """Raise FieldError unless a field of a dataclass instance is a rating of ``n`` devices."""
    value = getattr(owner, name)
    values = value if isinstance(value, tuple) else (value,) * n
    if len(values) != n or not all(is_number(v) and SMALLEST_RATING <= v <= LARGEST_RATING for v in values):
        remedy = f"give one positive number of at most {LARGEST_RATING:g}, or one for each of the {n} devices"
        raise refuse(owner, name, remedy)


def check_each(owner: object, name: str, n: int, low: float, high: float) -> None:
    """Raise FieldError unless a field of a dataclass instance is a number in [low, high], or one for each device."""
    value = getattr(owner, name)
    values = value if isinstance(value, tuple) else (value,)
    if (isinstance(value, tuple) and len(values) != n) or not all(finite(v, low, high) for v in values):
        raise refuse(owner, name, f"give one finite number in [{low:g}, {high:g}], or one for each of the {n} devices")


def per_device(value: Rating, n: int) -> np.ndarray:
    """A rating as an array over ``n`` devices."""
    return np.array(value, dtype=np.float64) if isinstance(value, tuple) else np.full(n, float(value))


def read_only(array: np.ndarray) -> np.ndarray:
    """The array itself, no longer writable: controllers are handed it, and must not change the physics."""
    array.setflags(write=False)
    return array
