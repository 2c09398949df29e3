"""Data centres of a scenario: buses, ratings, clock model and features."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from dcgrid_env.core.arrays import Array, namespace, positive_part, sum_last
from dcgrid_env.core.cache import PickledByFields
from dcgrid_env.core.checked import FieldError, count, number, part, refuse, settle
from dcgrid_env.devices.datacenter.batching import Batching
from dcgrid_env.devices.datacenter.clock_law import Dvfs, LinearDvfs, work_classes_of
from dcgrid_env.devices.datacenter.cooled_site import Cooling
from dcgrid_env.devices.datacenter.datacenter import DataCenterState
from dcgrid_env.devices.datacenter.feature_settings import check_settings, check_step, features_of
from dcgrid_env.devices.datacenter.plain_laws import clock_law
from dcgrid_env.devices.datacenter.power_smoothing import PowerSmoothing
from dcgrid_env.devices.datacenter.service_levels import ServiceLevels
from dcgrid_env.devices.datacenter.site_features import FeatureInputs, SiteFeature, SiteState
from dcgrid_env.devices.datacenter.site_metrics import site_metrics
from dcgrid_env.devices.datacenter.site_steps import SiteSteps
from dcgrid_env.devices.datacenter.site_storage import SiteStorage
from dcgrid_env.devices.datacenter.streaming_sites import StreamingSites
from dcgrid_env.devices.datacenter.work_routing import Routing
from dcgrid_env.devices.device import (
    Channel,
    CostTerm,
    DeviceInput,
    DeviceState,
    Field,
    GridChange,
    Q,
    Requests,
    Work,
    step_totals,
)
from dcgrid_env.devices.phases import Phases, check_phases
from dcgrid_env.devices.ratings import DataCenterParams, Rating, check_rating, per_device, read_only
from dcgrid_env.devices.ride_through.rules import UpsRideThrough
from dcgrid_env.grid import buses_as_text


@dataclass(frozen=True, kw_only=True)
class DataCenters(PickledByFields):
    """Data centres that differ only in their ratings. A rating is one number for all of them, or one for each."""

    kind: ClassVar[str] = "datacenter"
    prefix: ClassVar[str] = "dc"
    input: ClassVar[str | None] = "workload"
    levels: ClassVar[tuple[str, ...]] = ("backlog_kws", "class_backlog_kws")
    changes_grid: ClassVar[bool] = False

    count: int = count(0, 10_000)
    """Number of sites."""
    buses: tuple[int | str, ...] | None = None
    """Buses of the sites, stored as text, or None: drawn in each episode among the load buses without a device."""
    p_rated_kw: Rating
    """Rated power, kW."""
    idle_share: float = number(0.0, 0.99, default=0.23)
    """Idle draw as a share of the rating."""
    f_max_mhz: float = number(1e-9, 1e6, default=1410.0)
    """Highest clock, MHz."""
    f_min_mhz: float = number(1e-9, "f_max_mhz", default=210.0)
    """Lowest clock, MHz."""
    s_rated_share: float = number(1.0, 1e6)
    """Converter rating as a share of the rated power; with cooling, of the draw at the rating, see ``cooling``."""
    q_max_share: float = number(0.0, "s_rated_share")
    """Reactive limit as a share of the rated power."""
    clock_law: Dvfs = field(default_factory=LinearDvfs)
    """Model of speed and power by the clock: LinearDvfs(), PrefillDecodeDvfs(), PowerCapDvfs(), or a custom one. Plain
    form: "linear", "prefill-decode", "power-cap", or a mapping such as ``{"law": "prefill-decode",
    "decode_clock_share": 0.03}``."""
    boost_share: float = number(1.0, 2.0, default=1.0)
    """Highest short draw of a site as a share of its rating; values up to 1.3 have been observed."""
    phases: Phases | None = None
    """Phases of a three-phase feeder that a site draws from in equal parts, such as "abc" or "b". By default all
    phases of its bus; a bus that is drawn has all three."""
    ride_through: UpsRideThrough | None = part(UpsRideThrough, default=None, text="curve")
    """Rule for transfers to the UPS and returns; None for sites that stay connected at any voltage."""
    storage: SiteStorage | None = part(SiteStorage, default=None)
    """Storage behind the site's converter, controlled by the site's agent; None for sites without one."""
    smoothing: PowerSmoothing | None = part(PowerSmoothing, default=None)
    """GPU power smoothing; None for a draw that follows the work."""
    cooling: Cooling | None = part(Cooling, default=None)
    """Draw of a site in addition to its computers; None for no such draw. ``p_rated_kw`` is the rating of the
    computers. The converter grows by the same factor as the draw at the rating."""
    routing: Routing | None = part(Routing, default=None)
    """Settings for moving arriving work between the sites; None for work that stays where it arrives."""
    batching: Batching | None = part(Batching, default=None)
    """Batch sizes that the sites can be set to; None for those of the trace."""
    service: ServiceLevels | None = part(ServiceLevels, default=None)
    """Deadlines of the work; None for work without a deadline."""

    def __post_init__(self) -> None:
        settle(self, buses=buses_as_text, clock_law=_clock_law)
        if isinstance(self.clock_law, type) or not callable(getattr(self.clock_law, "serve", None)):
            remedy = "give 'linear', 'prefill-decode', 'power-cap', or a clock law such as PrefillDecodeDvfs()"
            raise refuse(self, "clock_law", remedy)
        if work_classes_of(self.clock_law) not in (1, 2):
            wrong = work_classes_of(self.clock_law)
            raise refuse(self, "clock_law", f"give a clock law of 1 or 2 work classes, not {wrong!r}")
        check_rating(self, "p_rated_kw", self.count)
        check_phases(self, self.count)
        check_settings(self)

    @cached_property
    def work_classes(self) -> int:
        """Number of work classes that the clock law distinguishes."""
        return work_classes_of(self.clock_law)

    @cached_property
    def features(self) -> tuple[SiteFeature, ...]:
        """Features in addition to clock, queue and converter, in order from the chips to the grid."""
        return features_of(self)

    @cached_property
    def _steps(self) -> SiteSteps:
        return SiteSteps(self.clock_law, self.boost_share, self.features, self.parameters)

    @cached_property
    def parameters(self) -> DataCenterParams:
        """Ratings as arrays over the sites."""
        p = per_device(self.p_rated_kw, self.count)
        one = np.ones_like(p)
        params = DataCenterParams(
            p_rated_kw=p,
            p_idle_kw=self.idle_share * p,
            p_dynamic_kw=p - self.idle_share * p,
            f_min_mhz=self.f_min_mhz * one,
            f_max_mhz=self.f_max_mhz * one,
            s_rated_kva=self.s_rated_share * (self.cooling.pue_at_rating * p if self.cooling else p),
            q_max_kvar=self.q_max_share * p,
        )
        return DataCenterParams(*map(read_only, params))

    @cached_property
    def q_limit_kvar(self) -> np.ndarray:
        """Reactive limit of each site at zero active power, kvar."""
        return read_only(np.minimum(self.parameters.q_max_kvar, self.parameters.s_rated_kva))

    @property
    def p_scale_kw(self) -> np.ndarray:
        """Rating that a draw is a share of, kW: that of the computers, without any additional draw."""
        return self.parameters.p_rated_kw

    @property
    def converter_kva(self) -> np.ndarray:
        """Apparent-power rating of each site's converter, kVA."""
        return self.parameters.s_rated_kva

    @property
    def largest_draw_share(self) -> float:
        """Highest draw as a share of the rating."""
        return self.cooling.largest_draw_share(self.boost_share) if self.cooling else self.boost_share

    @property
    def largest_export_share(self) -> float:
        """Highest injection of a site as a share of its rating: positive only with a storage behind its converter."""
        return 0.0 if self.storage is None else 1.0

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Channels: clock, then reactive power, then those of the features."""
        p, q = self.parameters, self.q_limit_kvar
        return (
            Channel("clock", "MHz", p.f_min_mhz, p.f_max_mhz, rest=p.f_max_mhz),
            Channel(Q, "kvar", -q, q, rest=0.0 * q),
            *(channel for feature in self.features for channel in feature.channels(p)),
        )

    def fields(self, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """Observed work: upcoming and waiting, in total and, if the law has two classes, compute-bound; and the
        fields of the features."""
        rated, boost = self.parameters.p_rated_kw, self.boost_share
        longest_s = horizon * dt_s * (boost + bool(self.routing))  # a site is given at most its rating beside its own
        of_features = [field for feature in self.features for field in feature.fields(self.parameters, horizon, dt_s)]
        common = (
            Field("p_ref_next", "share of the rating", 0.0, boost, rated, of_preview=True),
            Field("backlog", "s at the rating", 0.0, longest_s, rated),
        )
        if self.work_classes == 1:
            return (*common, *of_features)
        return (
            *common,
            Field("p_ref_next_compute", "share of the rating", 0.0, boost, rated, of_preview=True),
            Field("backlog_compute", "s at the rating", 0.0, longest_s, rated),
            *of_features,
        )

    def cost_terms(self, horizon: int, dt_s: float) -> tuple[CostTerm, ...]:
        """Cost terms: waiting work, leftover work, movement of the clock, and those of the features."""
        rated = self.parameters.p_rated_kw
        of_all = float(rated.sum()) or 1.0
        # A site to which work is moved is given at most what it can serve beside its own.
        arriving = self.boost_share - self.idle_share + (1.0 - self.idle_share) * bool(self.routing)
        queued = arriving * horizon * dt_s
        one = np.ones_like(rated)
        return (
            CostTerm("backlog", "backlog_kws", rated, of_all, queued),
            CostTerm("clock", "clock_movement", one, float(max(self.count, 1)), 1.0),
            CostTerm("leftover", "backlog_kws", rated, of_all, queued, at_end=True),
            *(term for feature in self.features for term in feature.cost_terms(self.parameters, horizon, dt_s)),
        )

    def check_episode(self, horizon: int) -> None:
        """Accept any number of steps: a data centre does not depend on the length of an episode."""

    def check_step(self, dt_s: float) -> None:
        """Raise FieldError for a feature that does not support steps of this length."""
        check_step(self, dt_s)

    def initial(self, parameters: DataCenterParams, zero: Array) -> DeviceState:
        """Return the initial state: empty queues, highest clocks, and the features' initial states."""
        xp = namespace(zero)
        by_class = xp.stack((zero, zero), axis=-1) if self.work_classes == 2 else zero
        top = zero + parameters.f_max_mhz
        site = DataCenterState(zero, top, top, zero, zero, by_class, by_class, by_class)
        if not self.features:
            return site
        return SiteState(*site, tuple(feature.initial(parameters, zero) for feature in self.features))

    def step(
        self,
        parameters: DataCenterParams,
        state: DeviceState,
        setpoints: tuple[Array, ...],
        device_input: DeviceInput,
        dt_s: float,
    ) -> tuple[Any, Array]:
        """Serve work at the speed of the clock, see ``datacenter.step``; features act on it, see ``site_features``."""
        if not self.features:
            return self._steps.without_features(parameters, state, setpoints[0], device_input, dt_s)
        supply = None if self.ride_through is None else device_input
        work = device_input if supply is None else supply.device_input
        return self._steps.with_features(parameters, state, setpoints, FeatureInputs(work, supply), dt_s)

    def connected(self, state: DeviceState) -> Array:
        """Return the share of each site's power that is on the grid, see ``device.may_leave``."""
        return state.ups.share

    def grid_change(self, parameters: DataCenterParams, state: DataCenterState) -> GridChange:
        """Change nothing in the grid."""
        return GridChange()

    def observe(self, parameters: DataCenterParams, state: DeviceState, given_next: Work) -> tuple[Array, ...]:
        """Return the raw figures of the fields, kW and kW s."""
        arriving, waiting = given_next.p_ref_kw, state.backlog_kws
        of_features = []
        for feature, feature_state in self._with_states(state):
            ahead = (given_next,) if getattr(feature, "looks_ahead", False) else ()
            of_features += feature.observe(parameters, feature_state, *ahead)
        if self.work_classes == 1:
            return (arriving, waiting, *of_features)
        compute = positive_part(arriving - parameters.p_idle_kw) * given_next.compute_share
        return arriving, waiting, compute, state.class_backlog_kws[..., 0], *of_features

    def amount(self, name: str, parameters: DataCenterParams, state: DeviceState) -> Array:
        """Return queued work, kW s, the clock's movement as a share of its range, or a feature's amount."""
        if name == "backlog_kws":
            return state.backlog_kws
        for feature, feature_state in self._with_states(state):
            if name in feature.amounts:
                return feature.amount(name, parameters, feature_state)
        span = self.f_max_mhz - self.f_min_mhz or 1.0
        return namespace(state.f_mhz).abs(state.f_mhz - state.f_last_mhz) / span

    @property
    def step_totals(self) -> tuple[str, ...]:
        """Names of the totals that count events of a step, those of the features."""
        return tuple(name for feature in self.features for name in step_totals(feature))

    def totals(self, state: DeviceState) -> dict[str, Array]:
        """Return the queued work of all sites, kW s, and the figures of the features."""
        figures = {"backlog_kws": sum_last(state.backlog_kws)}
        for feature, feature_state in self._with_states(state):
            figures |= feature.totals(feature_state)
        return figures

    def metrics(self, history: DeviceState, dt_s: float, requests: Requests) -> dict[str, float]:
        """Return waiting times, clocks, times of requests, and the metrics of the features."""
        latency_s = self.routing.move_latency_s if self.routing else 0.0
        figures = site_metrics(self.parameters, self.clock_law, history, dt_s, requests, latency_s)
        for feature, feature_state in self._with_states(history):
            figures |= feature.metrics(self.parameters, history, feature_state, dt_s)
        return figures

    def streaming(self, dt_s: float, requests: Requests) -> StreamingSites:
        """Return an accumulator of the figures of ``metrics`` for a streamed episode."""
        latency_s = self.routing.move_latency_s if self.routing else 0.0
        return StreamingSites(self.parameters, self.clock_law, self.features, latency_s, dt_s, requests)

    def _with_states(self, state: DeviceState) -> Iterable[tuple[SiteFeature, Any]]:
        return zip(self.features, state.features, strict=True) if self.features else ()


def _clock_law(value: object) -> Any:
    try:
        return clock_law(value)
    except ValueError as error:
        raise FieldError("DataCenters", "clock_law", value, str(error)) from None
