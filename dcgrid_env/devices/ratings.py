"""Ratings of the devices of a scenario, as arrays over its slots.

| device | field | unit | valid |
|---|---|---|---|
| data centre | p_rated_kw | kW | > 0 |
| | p_idle_kw | kW | 0 .. p_rated_kw |
| | f_min_mhz, f_max_mhz | MHz | 0 < f_min <= f_max |
| | s_rated_kva | kVA | >= p_rated_kw |
| | q_max_kvar | kvar | 0 < q_max <= s_rated_kva |
| inverter | s_rated_kva | kVA | > 0 |
"""

from __future__ import annotations

from typing import NamedTuple

from dcgrid_env.core.arrays import Array


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
