"""Work moved between sites: work that arrives at one may be served at another of the same group.

Of the work a_i that arrives at site i, the share ``movable_share`` m may be served elsewhere. The channel ``route``,
r_i from -1 to 1, sets how much of it the site gives away if negative, and how much work it accepts if positive:

    give_i = m a_i max(-r_i, 0)                  room_i = P_i max(r_i, 0)          P_i: dynamic power at the rating
    moved  = min(sum give, sum room)             what is given and finds room; the rest stays where it is
    a'_i   = a_i - give_i moved / sum give + room_i moved / sum room

The sum of a' therefore equals that of a. In a step, a site receives at most the work that it can serve in one step at
the top clock. Work that its clock does not serve waits in its queue. At r = 0 every site keeps its work. A
disconnected site has no room but may give work away. The draw other than for work is not moved.

Moved work can be served in the step in which it arrives, but counts as having waited ``move_latency_s`` by then. This
wait is charged (``move_weight``), and service levels reduce its slack by a step. The latency is at most one step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, namespace, positive_part, sum_last
from dcgrid_env.core.checked import FieldError, number, settle
from dcgrid_env.core.metric import Metric, cost_metric
from dcgrid_env.devices.datacenter.site_features import Load, PassiveFeature, SiteState
from dcgrid_env.devices.device import Channel, CostTerm, Field, Work
from dcgrid_env.devices.ratings import DataCenterParams

TINY_KW = 1e-30
"""Lower limit of a sum used as a divisor, kW."""


@dataclass(frozen=True, kw_only=True)
class Routing:
    """Settings for moving arriving work between the sites of a scenario; plain form: a mapping of these fields."""

    movable_share: float = number(0.0, 1.0, default=1.0)
    """Share of the arriving work that may be served at another site."""
    move_latency_s: float = number(0.0, 3600.0, default=0.05)
    """Additional latency of moved work, s; at most one step."""
    move_weight: float = number(0.0, 1e9, default=0.3)
    """Weight of the cost term ``moving``: seconds of latency of the work moved in a step, at the sites' rating."""

    def __post_init__(self) -> None:
        settle(self)

    def check_step(self, dt_s: float) -> None:
        """Raise FieldError if the latency is longer than a step."""
        if self.move_latency_s > dt_s:
            raise FieldError(
                "DataCenters",
                "routing.move_latency_s",
                self.move_latency_s,
                f"give at most one step, dt_s = {dt_s:g}, or 0",
            )


class RoutingState(NamedTuple):
    """State of the routing, (row, slot) each."""

    sent_kw: Array
    """Work that arrived here in the step and went elsewhere, kW."""
    received_kw: Array
    """Work that came from elsewhere, kW."""
    work_share: Array
    """Share of all work that arrived in the step that is served here or waits here; 0 where none arrived."""


METRICS = (
    cost_metric("moving", "cost of moves"),
    Metric("moved_kws", "work moved", "kW s", 1, "neither",
        "work that was served at another site than it arrived at", "sum"),
    Metric("moved_pct", "work moved", "% of what arrived", 1, "neither", "that work as a share of all", "mean",
        share_of="arrived_kw", tables=("run",)),
)  # fmt: skip
"""Metrics of sites between which work moves."""


@dataclass(frozen=True)
class RoutedSites(PassiveFeature):
    """Sites with this routing."""

    rule: Routing
    boost_share: float = 1.0

    amounts: ClassVar[tuple[str, ...]] = ("moved_kws",)
    looks_ahead: ClassVar[bool] = True

    def channels(self, params: DataCenterParams) -> tuple[Channel, ...]:
        """Channel: a site gives work away below 0, and receives work above 0."""
        one = np.ones(len(params.p_rated_kw))
        return (Channel("route", "share given (below 0) or taken (above)", -one, one, rest=0.0 * one),)

    def fields(self, params: DataCenterParams, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """The site's share of the work now, and what arrives at all sites next."""
        one = np.ones(len(params.p_rated_kw))
        all_kw = one * (float(params.p_dynamic_kw.sum()) or 1.0)
        idle_share = float((params.p_idle_kw / params.p_rated_kw).max(initial=0.0))
        most = (self.boost_share - idle_share) / (1.0 - idle_share)
        return (
            Field("work_share", "share of the work at all sites", 0.0, 1.0, one, of_all_sites=True),
            Field(
                "work_next_all",
                "share of all sites' dynamic power",
                0.0,
                most,
                all_kw,
                of_preview=True,
                of_all_sites=True,
            ),
        )

    def cost_terms(self, params: DataCenterParams, horizon: int, dt_s: float) -> tuple[CostTerm, ...]:
        """The latency of what is moved."""
        rated, rule = params.p_rated_kw, self.rule
        largest = rule.move_latency_s * self.boost_share
        return (CostTerm("moving", "moved_kws", rated, float(rated.sum()) or 1.0, largest, weight=rule.move_weight),)

    def initial(self, params: DataCenterParams, zero: Array) -> RoutingState:
        """Return the initial state: no work has been moved."""
        return RoutingState(zero, zero, zero)

    def admit(
        self,
        params: DataCenterParams,
        state: SiteState,
        feature_state: RoutingState,
        load: Load,
        setpoints: tuple[Array, ...],
        work: Work,
        dt_s: float,
    ) -> tuple[RoutingState, Load]:
        """Move work, see ``SiteFeature.admit``."""
        xp, arrived, route = namespace(load.arrived_kw), load.arrived_kw, setpoints[0]
        on_grid = self._on_grid(state, work)
        share = load.compute_share
        give = positive_part(-route) * self.rule.movable_share * arrived
        room = positive_part(route) * params.p_dynamic_kw
        room = room if on_grid is None else room * on_grid
        all_given, all_room = sum_last(give)[..., None], sum_last(room)[..., None]
        moved = xp.minimum(all_given, all_room)
        sent = give * (moved / (all_given + TINY_KW))
        received = room * (moved / (all_room + TINY_KW))
        after = arrived - sent + received
        if share is not None:
            compute = sum_last(sent * share)[..., None] / (sum_last(sent)[..., None] + TINY_KW)
            mixed = (arrived - sent) * share + received * compute
            share = xp.where(after > 0.0, mixed / (after + TINY_KW), share)
        of_all = after / (sum_last(after)[..., None] + TINY_KW)
        return RoutingState(sent, received, of_all), load._replace(
            arrived_kw=after, compute_share=share, moved_kw=received
        )

    def _on_grid(self, state: SiteState, work: Work) -> Array | None:
        """Share of each site that is on the grid, None where all are for certain."""
        ups = next((fields.ups for fields in state.features if "ups" in fields._fields), None)
        if ups is None:
            return work.available
        return ups.share if work.available is None else ups.share * work.available

    def observe(
        self, params: DataCenterParams, feature_state: RoutingState, given_next: Work | None = None
    ) -> tuple[Array, ...]:
        """Raw figures of ``fields``."""
        assert given_next is not None  # which a feature that looks ahead is always given
        arriving = positive_part(given_next.p_ref_kw - params.p_idle_kw)
        return feature_state.work_share, 0.0 * arriving + sum_last(arriving)[..., None]

    def amount(self, name: str, params: DataCenterParams, feature_state: RoutingState) -> Array:
        """Work that came from elsewhere, by how long it took, kW s."""
        return feature_state.received_kw * self.rule.move_latency_s

    def totals(self, feature_state: RoutingState) -> dict[str, Array]:
        """Work moved in the step."""
        return {"moved_kw": sum_last(feature_state.received_kw)}

    def metrics(
        self, params: DataCenterParams, history: SiteState, feature_state: RoutingState, dt_s: float
    ) -> dict[str, float]:
        """Figures of an episode, see ``core.metric``."""
        moved, arrived = feature_state.received_kw[1:].sum(), history.arrived_kw[1:].sum()
        return {"moved_kws": moved * dt_s, "moved_pct": 100.0 * moved / arrived if arrived > 0.0 else 0.0}
