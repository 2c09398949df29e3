"""Cooling and auxiliaries of data centres, a site feature: draw in addition to the computers.

    C'(t) = (k P - C) / tau       C: cooling power, k: cooling_share, P: draw of the computers, held over an interval
    drawn = P + mean of C over the interval + auxiliary_share p_rated

The lag is solved exactly over each interval, so any step length is stable and the energy balance is exact. Before t = 0
the cooling has settled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from dcgrid_env.core.arrays import Array, namespace, sum_last
from dcgrid_env.core.checked import number, settle
from dcgrid_env.core.metric import Metric
from dcgrid_env.devices.datacenter.datacenter import DataCenterState
from dcgrid_env.devices.datacenter.site_features import FeatureInputs, SiteState
from dcgrid_env.devices.device import Channel, CostTerm, Field
from dcgrid_env.devices.ratings import DataCenterParams

NONE_YET = -1.0
"""Cooling power before t = 0, when it has settled."""


@dataclass(frozen=True, kw_only=True)
class Cooling:
    """Draw of a site in addition to its computers.

    No source gives the figures: the defaults are choices with a power usage effectiveness of 1.25 at the rating."""

    cooling_share: float = number(0.0, 2.0, default=0.2)
    """Cooling power in the steady state as a share of the computers' draw."""
    time_constant_s: float = number(0.0, 86_400.0, default=120.0)
    """Time constant of the lag between the computers' draw and the cooling power, s; 0 for none."""
    auxiliary_share: float = number(0.0, 2.0, default=0.05)
    """Constant draw of everything else, as a share of the rating."""

    def __post_init__(self) -> None:
        settle(self)

    @property
    def pue_at_rating(self) -> float:
        """Power usage effectiveness in the steady state at the rating: total draw over the computers' draw."""
        return 1.0 + self.cooling_share + self.auxiliary_share

    def largest_draw_share(self, boost_share: float) -> float:
        """Return the highest draw of a site as a share of its rating if its computers draw ``boost_share`` at most."""
        return boost_share * (1.0 + self.cooling_share) + self.auxiliary_share


class CoolingState(NamedTuple):
    """State of the cooling of each site, (row, slot) each."""

    computing_kw: Array
    """Draw of the computers over the step, kW."""
    cooling_kw: Array
    """Mean cooling power over the step, kW."""
    cooling_end_kw: Array
    """Cooling power at its end, kW."""
    auxiliary_kw: Array
    """Draw of everything else over the step, kW."""


METRICS = (
    Metric("cooling_kwh", "energy of cooling", "kWh", 2, "lower", "energy of cooling", "sum"),
    Metric("pue", "PUE", "", 3, "lower", "power usage effectiveness of all sites over the episode", "mean",
        share_of="computing_kw", tables=("run",)),
)  # fmt: skip
"""Metrics of sites with cooling."""


@dataclass(frozen=True)
class CooledSite:
    """Sites with this cooling."""

    settings: Cooling
    boost_share: float
    """Highest draw of a site's computers as a share of its rating."""

    amounts: ClassVar[tuple[str, ...]] = ()

    def channels(self, params: DataCenterParams) -> tuple[Channel, ...]:
        """Nothing controls it."""
        return ()

    def fields(self, params: DataCenterParams, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """Cooling power."""
        most = self.settings.cooling_share * self.boost_share
        return (Field("cooling", "share of the rating", 0.0, most or 1.0, params.p_rated_kw),)

    def cost_terms(self, params: DataCenterParams, horizon: int, dt_s: float) -> tuple[CostTerm, ...]:
        """Empty: cooling has no cost term."""
        return ()

    def initial(self, params: DataCenterParams, zero: Array) -> CoolingState:
        """Return cooling that will have settled by t = 0."""
        return CoolingState(zero, zero, zero + NONE_YET, zero)

    def step(
        self,
        params: DataCenterParams,
        feature_state: CoolingState,
        site: DataCenterState,
        p_kw: Array,
        setpoints: tuple[Array, ...],
        inputs: FeatureInputs,
        dt_s: float,
    ) -> tuple[CoolingState, DataCenterState, Array]:
        """Advance by one interval, see ``SiteFeature.step``."""
        steady_kw = self.settings.cooling_share * p_kw
        begun_kw = namespace(p_kw).where(feature_state.cooling_end_kw < 0.0, steady_kw, feature_state.cooling_end_kw)
        left, mean = _left(self.settings.time_constant_s, dt_s)
        cooling_kw = steady_kw + mean * (begun_kw - steady_kw)
        auxiliary_kw = 0.0 * p_kw + self.settings.auxiliary_share * params.p_rated_kw
        after = CoolingState(p_kw, cooling_kw, steady_kw + left * (begun_kw - steady_kw), auxiliary_kw)
        return after, site, p_kw + cooling_kw + auxiliary_kw

    def with_supply(self, feature_state: CoolingState, share: Array) -> CoolingState:
        """The state where this share of the draw is supplied, (row, slot)."""
        drawn = (
            feature_state.computing_kw * share,
            feature_state.cooling_kw * share,
            feature_state.cooling_end_kw,
            feature_state.auxiliary_kw * share,
        )
        return CoolingState(*drawn)

    def observe(self, params: DataCenterParams, feature_state: CoolingState) -> tuple[Array, ...]:
        """Raw figures of ``fields``."""
        return (feature_state.cooling_end_kw,)

    def amount(self, name: str, params: DataCenterParams, feature_state: CoolingState) -> Array:
        """Nothing is charged."""
        raise ValueError(f"cooling charges nothing, and so no {name!r}; it has no cost terms")

    def totals(self, feature_state: CoolingState) -> dict[str, Array]:
        """Cooling power of all sites."""
        return {"cooling_kw": sum_last(feature_state.cooling_kw)}

    def metrics(
        self, params: DataCenterParams, history: SiteState, feature_state: CoolingState, dt_s: float
    ) -> dict[str, float]:
        """Energy of cooling, and the power usage effectiveness of all sites over the episode."""
        computing, cooling, rest = (
            kw[1:].sum() for kw in (feature_state.computing_kw, feature_state.cooling_kw, feature_state.auxiliary_kw)
        )
        pue = (computing + cooling + rest) / computing if computing > 0.0 else 1.0
        return {"cooling_kwh": cooling * dt_s / 3600.0, "pue": pue}


def _left(time_constant_s: float, dt_s: float) -> tuple[float, float]:
    """What is left of a distance to the steady state after an interval, and on average over it, as shares."""
    if time_constant_s <= 0.0:
        return 0.0, 0.0
    steps = dt_s / time_constant_s
    return math.exp(-steps), -math.expm1(-steps) / steps
