"""UPS of data centres, a site feature: connection to the grid and supply from a battery.

Work that is not supplied goes back into the queue, so none is lost.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, namespace, sum_last
from dcgrid_env.core.metric import Combined, Metric, cost_metric
from dcgrid_env.devices.datacenter.cooled_site import Cooling
from dcgrid_env.devices.datacenter.datacenter import DataCenterState
from dcgrid_env.devices.datacenter.site_features import FeatureInputs, SiteState, with_share_served
from dcgrid_env.devices.device import Channel, CostTerm, Field
from dcgrid_env.devices.ratings import DataCenterParams
from dcgrid_env.devices.ride_through import connection, connection_surrogate, ups_battery
from dcgrid_env.devices.ride_through.connection import ConnectionState
from dcgrid_env.devices.ride_through.rules import UpsRideThrough


class UpsState(NamedTuple):
    """State of the UPS of each site."""

    ups: ConnectionState
    battery: ups_battery.BatteryState


METRICS = (
    cost_metric("trips", "trip cost"),
    cost_metric("away", "cost of time away"),
    cost_metric("recharge", "cost of energy missing in UPS"),
    Metric("ups_trips", "sites tripped", "", 1, "lower", "number of times that a site left the grid", "sum",
        tables=("run",)),
    Metric("ups_lost_kw", "load lost", "kW", 1, "lower", "draw of the sites that left, in all", "sum"),
    Metric("ups_lost_step_kw", "load lost in a step", "kW", 1, "lower",
        "draw of the sites that left in one step, the most", "max", over_episodes="max", tables=("run",)),
    Metric("ups_away_s", "site-seconds away", "s", 1, "lower",
        "time of sites away from the grid, a ramp by its share", "sum", tables=("run",)),
    Metric("ups_locked_s", "site-seconds locked out", "s", 1, "lower", "time of sites locked out", "sum"),
    Metric("ups_all_back_s", "until all are back", "s", 1, "lower",
        "time from the first step with a site away to the last", tables=("run",)),
    Metric("battery_work_kws", "work on battery", "kW s", 1, "neither", "work served on battery", "sum"),
    Metric("battery_energy_kws", "energy of UPS used", "kW s", 1, "lower", "energy drawn from batteries", "sum"),
    Metric("battery_missing_kws", "energy missing in UPS", "kW s", 1, "lower",
        "energy missing in the batteries at the end", "last"),
)  # fmt: skip
"""Metrics of sites that may leave the grid."""


@dataclass(frozen=True)
class UpsSite:
    """Sites behind a UPS with this rule."""

    rule: UpsRideThrough
    cooling: Cooling | None = None
    """Draw of the sites in addition to their computers, which the UPS supplies too."""

    amounts: ClassVar[tuple[str, ...]] = ("tripped", "away", "missing_kws")
    step_totals: ClassVar[tuple[str, ...]] = ("ups_trips", "ups_lost_kw")

    def channels(self, params: DataCenterParams) -> tuple[Channel, ...]:
        """The return, where the agent decides: share of the site's power that comes back in a second, to stay where it
        is 0 or below. It runs to as far below 0 as above it, so that half of the range is to stay."""
        if self.rule.release != "agent":
            return ()
        fastest = np.full(len(params.p_rated_kw), 1.0 / self.rule.walk_in_s)
        return (Channel("return", "share/s", -fastest, fastest, rest=fastest),)

    def fields(self, params: DataCenterParams, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """Return the fields for the state of the UPS, its counters and its timers, as shares of their largest value."""
        rule, one = self.rule, np.ones(len(params.p_rated_kw))
        return (
            Field("ups_share", "share of the power on the grid", 0.0, 1.0, one),
            Field("ups_locked", "1 where locked out", 0.0, 1.0, one),
            Field("ups_events", "share of those that lock it out", 0.0, 1.0, one * max(rule.lockout_events, 1)),
            Field("ups_returns", "share of those of a minute", 0.0, 1.0, one * max(rule.returns_per_minute, 1)),
            Field("ups_timer", "share of the time to a slow trip", 0.0, 1.0, one),
            Field("ups_wait", "share of the longest delay", 0.0, 1.0, one * max(rule.longest_wait_s(len(one)), 1e-9)),
            Field("ups_stored", "share of the battery's energy", 0.0, 1.0, one),
        )

    def cost_terms(self, params: DataCenterParams, horizon: int, dt_s: float) -> tuple[CostTerm, ...]:
        """Trips, time away, and at the end what is missing in the batteries."""
        rule, rated_kw = self.rule, params.p_rated_kw
        one, slots = np.ones_like(rated_kw), float(max(len(rated_kw), 1))
        of_all = float(rated_kw.sum()) or 1.0
        most = rule.battery_s * self._site_share
        missing = CostTerm("recharge", "missing_kws", rated_kw, of_all, most, at_end=True, weight=rule.missing_weight)
        return (
            CostTerm("trips", "tripped", one, slots, 1.0, weight=rule.trip_weight, is_constraint=True),
            CostTerm("away", "away", one, slots, 1.0, weight=rule.away_weight),
            missing,
        )

    def initial(self, params: DataCenterParams, zero: Array) -> UpsState:
        """Return the initial state: connected, with a full battery."""
        full = zero + self._full_kws(params)
        return UpsState(connection.initial(self.rule, zero), ups_battery.BatteryState(full, zero, zero, zero))

    def step(
        self,
        params: DataCenterParams,
        feature_state: UpsState,
        site: DataCenterState,
        p_kw: Array,
        setpoints: tuple[Array, ...],
        inputs: FeatureInputs,
        dt_s: float,
    ) -> tuple[UpsState, DataCenterState, Array]:
        """Advance by one interval, see ``SiteFeature.step``."""
        xp, rule, supply = namespace(p_kw), self.rule, inputs.supply
        assert supply is not None
        pace: Any = connection.by_rule(rule, dt_s)
        if rule.release == "agent":
            rate = setpoints[0]
            pace = xp.where(rate > 0.0, rate * dt_s, 0.0 * rate)
            if supply.widths is not None:
                pace = connection_surrogate.smoothed_pace(pace, rate, 1.0 / rule.walk_in_s, dt_s, supply.widths)
        ups = connection.advance(rule, feature_state.ups, supply, pace, dt_s)
        idle_kw, rated_kw = xp.minimum(inputs.work.p_ref_kw, params.p_idle_kw), params.p_rated_kw
        if self.cooling is not None:
            idle_kw = (1.0 + self.cooling.cooling_share) * idle_kw + self.cooling.auxiliary_share * rated_kw
            rated_kw = rated_kw * self._site_share
        battery, grid_kw, works = ups_battery.step(
            rule, feature_state.battery.stored_kws, ups.share, p_kw, idle_kw, site.served_kw, rated_kw, dt_s
        )
        if supply.available is not None:  # what a fault has taken already is not lost again, and recharges nothing
            ups = ups._replace(tripped=ups.tripped * supply.available)
            battery = ups_battery.without_grid(rule, battery, supply.available, dt_s)
        ups = ups._replace(lost_kw=ups.tripped * feature_state.ups.share * p_kw)
        return UpsState(ups, battery), with_share_served(site, works, dt_s), grid_kw

    def supplied(self, feature_state: UpsState, p_kw: Array) -> Array:
        """Share of what the sites would draw, ``p_kw``, that grid and battery have supplied, (row, slot)."""
        xp, one = namespace(p_kw), 0.0 * p_kw + 1.0
        some = p_kw > 0.0
        share = (feature_state.ups.share * p_kw + feature_state.battery.battery_kw) / xp.where(some, p_kw, one)
        return xp.where(some, xp.minimum(share, one), one)

    @property
    def _site_share(self) -> float:
        """Rating of a site as a share of that of its computers."""
        return 1.0 if self.cooling is None else self.cooling.pue_at_rating

    def _full_kws(self, params: DataCenterParams) -> Array:
        """Energy of each full battery, kW s."""
        full = params.p_rated_kw * self.rule.battery_s
        return full if self.cooling is None else full * self._site_share

    def observe(self, params: DataCenterParams, feature_state: UpsState) -> tuple[Array, ...]:
        """Raw figures of ``fields``."""
        ups, rule = feature_state.ups, self.rule
        events, returns, timer_share = connection.counters(rule, ups)
        full = self._full_kws(params)
        stored = feature_state.battery.stored_kws / full if rule.battery_s > 0.0 else 0.0 * ups.share
        return ups.share, ups.locked, events, returns, timer_share, ups.wait_s, stored

    def amount(self, name: str, params: DataCenterParams, feature_state: UpsState) -> Array:
        """What the terms of ``cost_terms`` charge."""
        if name == "tripped":
            return feature_state.ups.tripped
        if name == "away":
            return 1.0 - feature_state.ups.share
        return self._full_kws(params) - feature_state.battery.stored_kws

    def totals(self, feature_state: UpsState) -> dict[str, Array]:
        """Trips and draw lost in the step, sites that are away or locked out, and the draw from batteries."""
        ups, xp = feature_state.ups, namespace(feature_state.ups.share)
        return {
            "ups_trips": sum_last(ups.tripped),
            "ups_lost_kw": sum_last(ups.lost_kw),
            "ups_away": sum_last(xp.astype(ups.share <= 0.0, ups.share.dtype)),
            "ups_locked": sum_last(ups.locked),
            "battery_kw": sum_last(feature_state.battery.battery_kw),
        }

    def metrics(
        self, params: DataCenterParams, history: SiteState, feature_state: UpsState, dt_s: float
    ) -> dict[str, float]:
        """Figures of an episode, see ``core.metric``."""
        whole = self.streaming(params, dt_s)
        whole.add(history, feature_state)
        return whole.figures()

    def streaming(self, params: DataCenterParams, dt_s: float) -> _StreamingUps:
        """Accumulator of the figures of ``metrics`` over a course that comes in parts."""
        return _StreamingUps(self._full_kws(params), dt_s)


class _StreamingUps:
    """Accumulates the figures of ``UpsSite`` for a streamed episode."""

    def __init__(self, full_kws: np.ndarray, dt_s: float):
        self._full_kws, self._dt_s = full_kws, dt_s
        self._combined = Combined(METRICS)
        self._steps = 0
        self._away: tuple[int, int] | None = None
        """The first and the last step with a site away."""

    def add(self, history: SiteState, feature_state: UpsState) -> None:
        """Take a part."""
        ups, battery, dt_s, steps = (
            feature_state.ups,
            feature_state.battery,
            self._dt_s,
            len(feature_state.ups.share) - 1,
        )
        lost_kw = ups.lost_kw[1:].sum(axis=1)
        gone = np.flatnonzero((ups.share[1:] < 1.0).any(axis=1)) + self._steps
        if len(gone):
            self._away = int(gone[0]) if self._away is None else self._away[0], int(gone[-1])
        self._steps += steps
        figures = {
            "ups_trips": ups.tripped[1:].sum(),
            "ups_lost_kw": lost_kw.sum(),
            "ups_lost_step_kw": lost_kw.max(initial=0.0),
            "ups_away_s": (1.0 - ups.share[1:]).sum() * dt_s,
            "ups_locked_s": ups.locked[1:].sum() * dt_s,
            "battery_work_kws": battery.battery_work_kw[1:].sum() * dt_s,
            "battery_energy_kws": battery.battery_kw[1:].sum() * dt_s,
            "battery_missing_kws": np.maximum(self._full_kws - battery.stored_kws[-1], 0.0).sum(),
        }
        self._combined.add(figures, steps)

    def figures(self) -> dict[str, float]:
        """Those of all parts so far."""
        away_s = 0.0 if self._away is None else (self._away[1] - self._away[0] + 1) * self._dt_s
        figures = self._combined.figures() | {"ups_all_back_s": away_s}
        return {metric.name: figures[metric.name] for metric in METRICS if metric.name in figures}
