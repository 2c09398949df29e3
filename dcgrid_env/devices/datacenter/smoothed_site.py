"""GPU power smoothing, a feature of data centres: a floor under the draw, and limits on its ramps.

    wanted = max(P, floor)  while the work takes as much as the floor and for the hysteresis time after,  else P
    S_t    = wanted within [S_{t-1} - down dt, S_{t-1} + up dt],  at least the idle draw      drawn
    burnt  = S_t - min(P, S_t)

P is the power for the work of the interval, including the idle draw. Of P, min(P, S_t) is supplied. The share of
work that is served equals the supplied share of the dynamic power, and the rest returns to the queue. Before t = 0
nothing limits a ramp.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, as_like, namespace, sum_last
from dcgrid_env.core.metric import Metric, cost_metric
from dcgrid_env.devices.datacenter.datacenter import DataCenterState
from dcgrid_env.devices.datacenter.power_smoothing import PowerSmoothing
from dcgrid_env.devices.datacenter.site_features import FeatureInputs, SiteState, with_share_served
from dcgrid_env.devices.device import Channel, CostTerm, Field
from dcgrid_env.devices.ratings import DataCenterParams

NONE_YET = -1.0
"""Draw before t = 0, which limits no ramp."""


class SmoothingState(NamedTuple):
    """State of the power smoothing of each site, (row, slot) each."""

    smoothed_kw: Array
    """Draw over the step, kW."""
    burnt_kw: Array
    """What is drawn beyond what idling and the work served take, kW."""
    held_back_kw: Array
    """Dynamic power of the work that slow ramps have put back into the queue, kW."""
    quiet_s: Array
    """How long the work has taken less than the floor, s, the hysteresis at most."""
    floor_kw: Array
    """The floor, whether it is held or released, kW."""
    ramp_up_kw_per_s: Array
    ramp_down_kw_per_s: Array
    unchanged_s: Array
    """Remaining time for which floor and ramps cannot change, s."""


METRICS = (
    cost_metric("burnt", "cost of burnt power"),
    Metric("burnt_kwh", "energy burnt", "kWh", 2, "lower", "energy burnt by the floor of power smoothing", "sum",
        tables=("run",)),
    Metric("burnt_pct", "energy burnt, share", "% of the computers'", 1, "lower",
        "that energy as a share of what the computers draw", "mean", share_of="smoothed_kw"),
    Metric("held_back_kws", "work held back by ramps", "kW s", 1, "lower", "work held back by ramps", "sum",
        tables=("run",)),
    Metric("floor_mean_pct", "mean floor", "% of the rating", 1, "neither", "mean floor as a share of the rating",
        "mean"),
)  # fmt: skip
"""Metrics of sites that smooth their power."""


@dataclass(frozen=True)
class SmoothedSite:
    """Sites with this power smoothing."""

    settings: PowerSmoothing
    boost_share: float
    """Highest draw of a site as a share of its rating."""

    amounts: ClassVar[tuple[str, ...]] = ("burnt_kw",)

    @property
    def by_agent(self) -> bool:
        """Whether floor and ramps are channels."""
        return self.settings.control == "agent"

    def channels(self, params: DataCenterParams) -> tuple[Channel, ...]:
        """Floor and ramps, where the agent decides; a ramp as the power of ten that the fastest is multiplied by."""
        if not self.by_agent:
            return ()
        zeros = np.zeros(len(params.p_rated_kw))
        floor = Channel("floor", "share of the rating", zeros, zeros + self.settings.floor_share, rest=zeros)
        slowest = zeros + np.log10(self.settings.slowest_share)
        ramps = (Channel(f"ramp_{way}", "log10 of a share", slowest, zeros, rest=zeros) for way in ("up", "down"))
        return (floor, *ramps)

    def fields(self, params: DataCenterParams, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """Draw, the floor that is held over the coming interval and the hysteresis; and what is set by the agent."""
        settings, rated_kw = self.settings, params.p_rated_kw
        one = np.ones_like(rated_kw)
        common = (
            Field("smoothed", "share of the rating", 0.0, self.boost_share, rated_kw),
            Field("floor_held", "share of the rating", 0.0, 1.0, rated_kw),
            Field("quiet", "share of the hysteresis", 0.0, 1.0, one * (settings.hysteresis_s or 1.0)),
        )
        if not self.by_agent:
            return common
        up, down = settings.ramps_kw_per_s(rated_kw)
        return (
            *common,
            Field("floor_set", "share of the rating", 0.0, 1.0, rated_kw),
            Field("ramp_up_set", "share of the fastest", 0.0, 1.0, up),
            Field("ramp_down_set", "share of the fastest", 0.0, 1.0, down),
            Field("settings_held", "share of the time they are held", 0.0, 1.0, one * (settings.change_every_s or 1.0)),
        )

    def cost_terms(self, params: DataCenterParams, horizon: int, dt_s: float) -> tuple[CostTerm, ...]:
        """Power burnt."""
        rated_kw = params.p_rated_kw
        of_all = float(rated_kw.sum()) or 1.0
        return (CostTerm("burnt", "burnt_kw", rated_kw, of_all, self.boost_share, weight=self.settings.burnt_weight),)

    def initial(self, params: DataCenterParams, zero: Array) -> SmoothingState:
        """Return the initial state: no previous draw that limits a ramp, and a floor of 0 if the agent sets it."""
        floor_kw = zero if self.by_agent else zero + self.settings.floor_share * params.p_rated_kw
        up, down = self._fastest(params, zero)
        return SmoothingState(zero + NONE_YET, zero, zero, zero, floor_kw, zero + up, zero + down, zero)

    def step(
        self,
        params: DataCenterParams,
        feature_state: SmoothingState,
        site: DataCenterState,
        p_kw: Array,
        setpoints: tuple[Array, ...],
        inputs: FeatureInputs,
        dt_s: float,
    ) -> tuple[SmoothingState, DataCenterState, Array]:
        """Advance by one interval, see ``SiteFeature.step``."""
        xp, hysteresis_s = namespace(p_kw), self.settings.hysteresis_s
        began = feature_state.smoothed_kw < 0.0
        feature_state = self._set(params, feature_state, setpoints, dt_s)
        busy = p_kw >= feature_state.floor_kw
        wanted = xp.where(busy | self._keeps_floor(feature_state), xp.maximum(p_kw, feature_state.floor_kw), p_kw)
        idle_kw = xp.minimum(inputs.work.p_ref_kw, params.p_idle_kw)
        lowest = feature_state.smoothed_kw - feature_state.ramp_down_kw_per_s * dt_s
        highest = feature_state.smoothed_kw + feature_state.ramp_up_kw_per_s * dt_s
        within = xp.maximum(xp.minimum(xp.maximum(wanted, lowest), highest), idle_kw)
        smoothed_kw = xp.where(began, wanted, within)
        supplied_kw = xp.minimum(p_kw, smoothed_kw)
        dynamic_kw = p_kw - idle_kw
        works = dynamic_kw > 0.0
        one = 0.0 * p_kw + 1.0
        share = xp.where(works, (supplied_kw - idle_kw) / xp.where(works, dynamic_kw, one), one)
        quiet_s = feature_state.quiet_s + dt_s
        longest_s = 0.0 * p_kw + hysteresis_s  # a time is rounded to whole steps
        after = feature_state._replace(
            smoothed_kw=smoothed_kw,
            burnt_kw=smoothed_kw - supplied_kw,
            held_back_kw=p_kw - supplied_kw,
            quiet_s=xp.where(busy, 0.0 * quiet_s, xp.where(quiet_s < hysteresis_s - 0.5 * dt_s, quiet_s, longest_s)),
        )
        return after, with_share_served(site, share, dt_s), smoothed_kw

    def with_supply(self, feature_state: SmoothingState, share: Array) -> SmoothingState:
        """Return the state if only this share of the draw is supplied, (row, slot); the burnt power scales with it."""
        return feature_state._replace(burnt_kw=feature_state.burnt_kw * share)

    def observe(self, params: DataCenterParams, feature_state: SmoothingState) -> tuple[Array, ...]:
        """Raw figures of ``fields``."""
        held_kw = namespace(feature_state.quiet_s).where(
            self._keeps_floor(feature_state), feature_state.floor_kw, 0.0 * feature_state.floor_kw
        )
        common = (feature_state.smoothed_kw, held_kw, feature_state.quiet_s)
        if not self.by_agent:
            return common
        return (
            *common,
            feature_state.floor_kw,
            feature_state.ramp_up_kw_per_s,
            feature_state.ramp_down_kw_per_s,
            feature_state.unchanged_s,
        )

    def amount(self, name: str, params: DataCenterParams, feature_state: SmoothingState) -> Array:
        """Power burnt, kW."""
        return feature_state.burnt_kw

    def totals(self, feature_state: SmoothingState) -> dict[str, Array]:
        """Power burnt and work held back in the step."""
        return {"burnt_kw": sum_last(feature_state.burnt_kw), "held_back_kw": sum_last(feature_state.held_back_kw)}

    def metrics(
        self, params: DataCenterParams, history: SiteState, feature_state: SmoothingState, dt_s: float
    ) -> dict[str, float]:
        """Figures of an episode, see ``core.metric``."""
        burnt_kws = feature_state.burnt_kw[1:].sum() * dt_s
        drawn_kws = feature_state.smoothed_kw[1:].sum() * dt_s
        return {
            "burnt_kwh": burnt_kws / 3600.0,
            "burnt_pct": 100.0 * burnt_kws / drawn_kws if drawn_kws > 0.0 else 0.0,
            "held_back_kws": feature_state.held_back_kw[1:].sum() * dt_s,
            "floor_mean_pct": 100.0 * (feature_state.floor_kw[1:] / params.p_rated_kw).mean()
            if feature_state.floor_kw.size
            else 0.0,
        }

    def _keeps_floor(self, feature_state: SmoothingState) -> Array:
        """Whether the floor outlasts the work over the coming interval."""
        return feature_state.quiet_s < self.settings.hysteresis_s

    def _fastest(self, params: DataCenterParams, like: Array) -> tuple[Array, Array]:
        up, down = self.settings.ramps_kw_per_s(np.asarray(params.p_rated_kw, dtype=np.float64))
        return as_like(up, like), as_like(down, like)

    def _set(
        self, params: DataCenterParams, feature_state: SmoothingState, setpoints: tuple[Array, ...], dt_s: float
    ) -> SmoothingState:
        """Take what the agent sets, where it may change."""
        if not self.by_agent:
            return feature_state
        xp, (floor, up, down) = namespace(feature_state.quiet_s), setpoints
        may = feature_state.unchanged_s < 0.5 * dt_s
        fastest_up, fastest_down = self._fastest(params, feature_state.quiet_s)
        # What is at rest at t = 0 may change in the first step.
        hold_s = xp.where(
            feature_state.smoothed_kw < 0.0,
            0.0 * feature_state.quiet_s,
            0.0 * feature_state.quiet_s + self.settings.change_every_s,
        )
        return feature_state._replace(
            floor_kw=xp.where(may, floor * params.p_rated_kw, feature_state.floor_kw),
            ramp_up_kw_per_s=xp.where(may, fastest_up * 10.0**up, feature_state.ramp_up_kw_per_s),
            ramp_down_kw_per_s=xp.where(may, fastest_down * 10.0**down, feature_state.ramp_down_kw_per_s),
            unchanged_s=xp.maximum(xp.where(may, hold_s, feature_state.unchanged_s) - dt_s, 0.0 * hold_s),
        )
