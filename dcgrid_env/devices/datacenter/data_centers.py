"""Data centres of a scenario: where they stand, how large they are, and how their clock acts."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from dcgrid_env.core.arrays import Array, namespace, positive_part, sum_last
from dcgrid_env.core.cache import PickledByFields
from dcgrid_env.core.checked import FieldError, check_fields, count, number, refuse, settle
from dcgrid_env.devices.datacenter import ups_site
from dcgrid_env.devices.datacenter.clock_law import Dvfs, LinearDvfs, speed_share, work_classes_of
from dcgrid_env.devices.datacenter.datacenter import DataCenterState, step
from dcgrid_env.devices.datacenter.plain_laws import clock_law
from dcgrid_env.devices.datacenter.request_delay import RequestDelays, request_delays, serve_requests
from dcgrid_env.devices.datacenter.waiting_time import fcfs_delays
from dcgrid_env.devices.device import Channel, CostTerm, Field, GridChange, Q, Work
from dcgrid_env.devices.phases import Phases, check_phases
from dcgrid_env.devices.ratings import DataCenterParams, Rating, check_rating, per_device, read_only
from dcgrid_env.devices.ride_through.rules import UpsRideThrough, rule_of
from dcgrid_env.grid import buses_as_text


@dataclass(frozen=True, kw_only=True)
class DataCenters(PickledByFields):
    """Sites alike but for their ratings. A rating is one number for all of them, or one for each."""

    kind: ClassVar[str] = "datacenter"
    prefix: ClassVar[str] = "dc"
    input: ClassVar[str | None] = "workload"
    levels: ClassVar[tuple[str, ...]] = ("backlog_kws", "class_backlog_kws")
    changes_grid: ClassVar[bool] = False

    count: int = count(0, 10_000)
    """Number of sites."""
    buses: tuple[int | str, ...] | None = None
    """Their buses, kept as text, or None: drawn in each episode among the load buses without a device."""
    p_rated_kw: Rating
    """Rated power, kW."""
    idle_share: float = number(0.0, 0.99, default=0.23)
    """Idle draw as a share of the rating."""
    f_max_mhz: float = number(1e-9, float("inf"), default=1410.0)
    """Highest clock, MHz."""
    f_min_mhz: float = number(1e-9, "f_max_mhz", default=210.0)
    """Lowest clock, MHz."""
    s_rated_share: float = number(1.0, float("inf"))
    """Converter rating as a share of the rated power."""
    q_max_share: float = number(0.0, "s_rated_share")
    """Reactive limit as a share of the rated power."""
    clock_law: Dvfs = field(default_factory=LinearDvfs)
    """How the clock turns work into speed and power: LinearDvfs(), PrefillDecodeDvfs(), or one's own. Plain form:
    "linear", "prefill-decode", or a mapping such as ``{"law": "prefill-decode", "decode_clock_share": 0.03}``."""
    boost_share: float = number(1.0, 2.0, default=1.0)
    """Highest short draw of a site as a share of its rating; up to 1.3 has been seen."""
    phases: Phases | None = None
    """Phases of a three-phase feeder that a site draws from in equal parts, such as "abc" or "b". By default all that
    its bus has, which are all three where the bus is drawn."""
    ride_through: UpsRideThrough | None = None
    """When a site goes over to its UPS, and how it returns; None for sites that stay connected whatever the voltage."""

    def __post_init__(self) -> None:
        settle(self, buses=buses_as_text, clock_law=_clock_law, ride_through=lambda v: rule_of(UpsRideThrough, v))
        check_fields(self)
        if isinstance(self.clock_law, type) or not callable(getattr(self.clock_law, "serve", None)):
            raise refuse(
                self, "clock_law", "give 'linear', 'prefill-decode', or a clock law such as PrefillDecodeDvfs()"
            )
        if hasattr(self.clock_law, "phases") and not hasattr(self.clock_law, "work_classes"):  # its older name
            raise refuse(self, "clock_law", "the law says 'phases'; name that attribute 'work_classes'")
        if work_classes_of(self.clock_law) not in (1, 2):
            wrong = work_classes_of(self.clock_law)
            raise refuse(self, "clock_law", f"give a clock law of 1 or 2 work classes, not {wrong!r}")
        check_rating(self, "p_rated_kw", self.count)
        check_phases(self, self.count)
        if self.ride_through is not None:
            if not isinstance(self.ride_through, UpsRideThrough):
                raise refuse(self, "ride_through", "give UpsRideThrough(curve=..), a mapping of its fields, or None")
            self.ride_through.check_slots(self.count)

    @cached_property
    def work_classes(self) -> int:
        """Number of work classes that the clock law tells apart."""
        return work_classes_of(self.clock_law)

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
            s_rated_kva=self.s_rated_share * p,
            q_max_kvar=self.q_max_share * p,
        )
        return DataCenterParams(*map(read_only, params))

    @cached_property
    def q_limit_kvar(self) -> np.ndarray:
        """Reactive limit of each site at zero active power, kvar."""
        return read_only(np.minimum(self.parameters.q_max_kvar, self.parameters.s_rated_kva))

    @property
    def p_scale_kw(self) -> np.ndarray:
        """Rating that a draw is a share of, kW."""
        return self.parameters.p_rated_kw

    @property
    def converter_kva(self) -> np.ndarray:
        """Apparent-power rating of each site's converter, kVA."""
        return self.parameters.s_rated_kva

    @property
    def largest_draw_share(self) -> float:
        """Highest draw as a share of the rating."""
        return self.boost_share

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Clock, then reactive power, then the return where the agent decides over it."""
        p, q, rule = self.parameters, self.q_limit_kvar, self.ride_through
        return (
            Channel("clock", "MHz", p.f_min_mhz, p.f_max_mhz, rest=p.f_max_mhz),
            Channel(Q, "kvar", -q, q, rest=0.0 * q),
            *(ups_site.channels(rule, self.count) if rule else ()),
        )

    def fields(self, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """Work to come and work that waits, in all and, where the law tells two classes apart, compute-bound; and where
        the UPS stands."""
        rated, boost = self.parameters.p_rated_kw, self.boost_share
        longest_s = horizon * dt_s * boost
        of_ups = ups_site.fields(self.ride_through, self.count) if self.ride_through else ()
        common = (
            Field("p_ref_next", "share of the rating", 0.0, boost, rated, of_preview=True),
            Field("backlog", "s at the rating", 0.0, longest_s, rated),
        )
        if self.work_classes == 1:
            return (*common, *of_ups)
        return (
            *common,
            Field("p_ref_next_compute", "share of the rating", 0.0, boost, rated, of_preview=True),
            Field("backlog_compute", "s at the rating", 0.0, longest_s, rated),
            *of_ups,
        )

    def cost_terms(self, horizon: int, dt_s: float) -> tuple[CostTerm, ...]:
        """Work that waits, work that is left over, and the movement of the clock."""
        rated = self.parameters.p_rated_kw
        of_all = float(rated.sum()) or 1.0
        queued = (self.boost_share - self.idle_share) * horizon * dt_s
        one = np.ones_like(rated)
        return (
            CostTerm("backlog", "backlog_kws", rated, of_all, queued),
            CostTerm("clock", "clock_movement", one, float(max(self.count, 1)), 1.0),
            CostTerm("leftover", "backlog_kws", rated, of_all, queued, at_end=True),
            *(ups_site.cost_terms(self.ride_through, rated) if self.ride_through else ()),
        )

    def check_episode(self, horizon: int) -> None:
        """Nothing of a data centre depends on the length of an episode."""

    def initial(self, parameters: DataCenterParams, zero: Array) -> Any:
        """Empty queues, the clocks at their top, and where there is a UPS all on the grid."""
        xp = namespace(zero)
        by_class = xp.stack((zero, zero), axis=-1) if self.work_classes == 2 else zero
        top = zero + parameters.f_max_mhz
        site = DataCenterState(zero, top, top, zero, zero, by_class, by_class, by_class)
        return ups_site.initial(self.ride_through, parameters, site, zero) if self.ride_through else site

    def step(
        self,
        parameters: DataCenterParams,
        state: Any,
        setpoints: tuple[Array, ...],
        given: Any,
        dt_s: float,
    ) -> tuple[Any, Array]:
        """Serve work as the clock allows, see ``datacenter.step``; and where there is a UPS, ``ups_site.step``."""
        if self.ride_through is None:
            return self._serve(parameters, state, setpoints[0], given, dt_s)

        def serve(site: DataCenterState, f_mhz: Array, work: Work) -> tuple[DataCenterState, Array]:
            return self._serve(parameters, site, f_mhz, work, dt_s)

        return ups_site.step(self.ride_through, parameters, state, setpoints, given, dt_s, serve)

    def connected(self, state: Any) -> Array:
        """Share of each site's power that is on the grid, see ``device.may_leave``."""
        return state.ups.share

    def _serve(
        self, parameters: DataCenterParams, state: DataCenterState, f_mhz: Array, given: Work, dt_s: float
    ) -> tuple[DataCenterState, Array]:
        share = given.compute_share if self.work_classes == 2 else None
        boosts = self.boost_share > 1.0
        done = step(
            parameters, self.clock_law, state.class_backlog_kws, given.p_ref_kw, f_mhz, dt_s, share, boost=boosts
        )
        after = DataCenterState(
            done.backlog_kws, f_mhz, state.f_mhz, done.arrived_kw, done.served_kw, done.class_backlog_kws,
            done.class_arrived_kw, done.class_served_kw,
        )  # fmt: skip
        return after, done.p_kw

    def grid_change(self, parameters: DataCenterParams, state: DataCenterState) -> GridChange:
        """Leave the grid as it is."""
        return GridChange()

    def observe(self, parameters: DataCenterParams, state: Any, given_next: Work) -> tuple[Array, ...]:
        """Raw figures of the fields, kW and kW s."""
        coming, waiting = given_next.p_ref_kw, state.backlog_kws
        of_ups = ups_site.observe(self.ride_through, parameters, state) if self.ride_through else ()
        if self.work_classes == 1:
            return (coming, waiting, *of_ups)
        compute = positive_part(coming - parameters.p_idle_kw) * given_next.compute_share
        return coming, waiting, compute, state.class_backlog_kws[..., 0], *of_ups

    def amount(self, name: str, parameters: DataCenterParams, state: Any) -> Array:
        """Queued work, kW s, or the clock's movement as a share of its range; or what the UPS is charged for."""
        if name == "backlog_kws":
            return state.backlog_kws
        if self.ride_through:
            of_ups = ups_site.amount(self.ride_through, name, parameters, state)
            if of_ups is not None:
                return of_ups
        span = self.f_max_mhz - self.f_min_mhz or 1.0
        return namespace(state.f_mhz).abs(state.f_mhz - state.f_last_mhz) / span

    def totals(self, state: Any) -> dict[str, Array]:
        """Queued work of all sites, kW s, and where their UPS stand."""
        own = {"backlog_kws": sum_last(state.backlog_kws)}
        return own | ups_site.totals(state) if self.ride_through else own

    def metrics(self, history: Any, dt_s: float, requests: Any) -> dict[str, float]:
        """Waiting times, clocks, and times of requests where the load is made of them."""
        arrived, served = (w[1:].reshape(len(w) - 1, -1) for w in (history.class_arrived_kw, history.class_served_kw))
        delays = fcfs_delays(arrived, served, dt_s)
        clock = history.f_mhz[1:].mean() / self.f_max_mhz if self.count else 1.0
        return {
            "delay_mean_s": delays.mean_s,
            "delay_p50_s": delays.p50_s,
            "delay_p95_s": delays.p95_s,
            "delay_p99_s": delays.p99_s,
            "arrived_kws": delays.arrived_kws,
            "unserved_kws": delays.unserved_kws,
            "clock_mean_pct": 100.0 * clock,
            **(self._request_delays(history, dt_s, requests)._asdict() if requests else {}),
            **self._ups_metrics(history, dt_s),
        }

    def _ups_metrics(self, history: Any, dt_s: float) -> dict[str, float]:
        rule = self.ride_through
        return ups_site.metrics(rule, self.parameters.p_rated_kw, history, dt_s) if rule else {}

    def _request_delays(self, history: DataCenterState, dt_s: float, requests: Any) -> RequestDelays:
        """Figures over the requests of all sites."""
        parts = (history.class_arrived_kw[1:], history.class_served_kw[1:])
        arrived, served = (w.reshape(*w.shape[:2], -1) for w in parts)
        speed = speed_share(self.clock_law, self.parameters, history.f_mhz[1:])
        return request_delays(
            serve_requests(times, begin_s, arrived[:, i], served[:, i], speed[:, i], dt_s)
            for i, (times, begin_s) in enumerate(requests)
        )


def _clock_law(value: Any) -> Any:
    try:
        return clock_law(value)
    except ValueError as error:
        raise FieldError("DataCenters", "clock_law", value, str(error)) from None
