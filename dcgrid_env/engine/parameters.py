"""A scenario's fixed figures as arrays of one kind, so that the physics runs on NumPy arrays and tensors alike."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, namespace
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.devices import DataCenterParams
from dcgrid_env.scenario.scenario import Scenario


class Constants(NamedTuple):
    """Arrays over slots; agents are ordered data centres first."""

    datacenter: DataCenterParams
    f_middle_mhz: Array
    f_half_range_mhz: Array
    """The data centres' clock range, (n_dc,)."""
    p_scale_kw: Array
    """Rating that a draw is a share of, kW or kVA, (n_agent,)."""
    q_scale_kvar: Array
    """Reactive limit at zero active power, kvar, (n_agent,)."""
    per_q_scale: Array
    """1 / q_scale_kvar, and 0 for a device without reactive power."""
    s_rated_kva: Array
    """Apparent-power rating, which reactive effort is a share of, kVA, (n_agent,)."""
    one: Array
    minus_one: Array
    """1 and -1 without dimensions: tensors take no plain number in minimum and maximum."""
    p_rated_sum_kw: float
    """Sum of the data centres' ratings, kW; 1 where there are none."""
    p_all_kw: float
    """Sum of the feeder's base load and the data centres' ratings, kW, which losses are a share of."""


def inverse(values: np.ndarray) -> np.ndarray:
    """1 / values, and 0 where they are 0."""
    return np.divide(1.0, values, out=np.zeros_like(values), where=values > 0)


def constants(scenario: Scenario, like: Array) -> Constants:
    """The constants as arrays of the kind, precision and device of ``like``; made once for each."""
    if isinstance(like, np.ndarray) and like.dtype == np.float64:
        return _on_numpy(scenario)
    return _constants(scenario, namespace(like), like.dtype, like.device)


@cached_on_owner
def _on_numpy(scenario: Scenario) -> Constants:
    """The common case with a shorter key: this is asked several times a step."""
    like = np.empty(0)
    return _constants(scenario, namespace(like), like.dtype, like.device)


@cached_on_owner
def _constants(scenario: Scenario, xp: Any, dtype: Any, device: Any) -> Constants:
    dc, inv = scenario.datacenter, scenario.inverter

    def array(values: Any) -> Array:
        return xp.asarray(np.array(values, dtype=np.float64), dtype=dtype, device=device)

    return Constants(
        datacenter=DataCenterParams(*map(array, dc)),
        f_middle_mhz=array(0.5 * (dc.f_max_mhz + dc.f_min_mhz)),
        f_half_range_mhz=array(0.5 * (dc.f_max_mhz - dc.f_min_mhz)),
        p_scale_kw=array(np.concatenate((dc.p_rated_kw, inv.s_rated_kva))),
        q_scale_kvar=array(scenario.q_scale_kvar),
        per_q_scale=array(inverse(scenario.q_scale_kvar)),
        s_rated_kva=array(np.concatenate((dc.s_rated_kva, inv.s_rated_kva))),
        one=array(1.0),
        minus_one=array(-1.0),
        p_rated_sum_kw=float(dc.p_rated_kw.sum()) or 1.0,
        p_all_kw=float(dc.p_rated_kw.sum() + np.abs(scenario.feeder.p_load_kw).sum()) or 1.0,
    )
