"""Service levels: work is interactive, with a target, or deferrable, with a deadline, and late work is charged.

The queue of a site is sorted by slack: bin j contains the work that has j more steps to be served in time, and bin 0
the overdue work. With D = floor(deadline / dt), work that arrives with deadline D may be served in the step of its
arrival and in the D steps after it. In each step, served work leaves the first bins, and the rest moves down by one:

    x_j    = queue_j, and at D + 1 what arrives                served from the front: clip(s dt - sum_{i<j} x_i, 0, x_j)
    queue' = (left_0 + left_1, left_2, ..)

This is earliest deadline first. First come first served uses the same bins with all work entered at the longest
deadline, so the bins order work by age. Each bin then mixes both kinds as they arrive, and interactive work is overdue
in all bins that are old enough. The order does not change the clock or the power of the site.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, as_like, namespace, positive_part, sum_last
from dcgrid_env.core.checked import FieldError, choice, number, refuse, settle
from dcgrid_env.core.formula import compiled_as
from dcgrid_env.core.metric import Metric, cost_metric
from dcgrid_env.devices.datacenter.datacenter import DataCenterState
from dcgrid_env.devices.datacenter.lateness import lateness
from dcgrid_env.devices.datacenter.site_features import FeatureInputs, PassiveFeature, SiteState
from dcgrid_env.devices.datacenter.streaming_lateness import StreamingLateness
from dcgrid_env.devices.device import CostTerm, Field
from dcgrid_env.devices.ratings import DataCenterParams

MOST_BINS = 600
"""Largest deadline in steps: the queue has a bin for each."""


@dataclass(frozen=True, kw_only=True)
class ServiceLevels:
    """Deadlines of the work, and the order in which it is served; plain form: a mapping of these fields."""

    target_s: float = number(0.0, 1e6, default=2.0)
    """Time in which interactive work must be served, s."""
    deadline_s: float = number(1e-3, 1e6, default=30.0)
    """Time in which deferrable work must be served, s; longer than the target."""
    interactive_share: float = number(0.0, 1.0, default=0.7)
    """Share of the arriving work that is interactive."""
    order: Literal["edf", "fcfs"] = choice("edf", "fcfs", default="edf")
    """Order of service: earliest deadline first, or first come first served."""
    late_weight: float = number(0.0, 1e9, default=3.0)
    """Weight of the cost term ``late``: seconds of work at the rating that are overdue."""

    def __post_init__(self) -> None:
        settle(self)
        if not self.target_s < self.deadline_s:
            raise refuse(self, "deadline_s", f"give more than target_s = {self.target_s:g}")

    def check_step(self, dt_s: float) -> None:
        """Raise FieldError where the deadline is too many steps away, or comes before the first ends."""
        if self.deadline_s / dt_s > MOST_BINS:
            remedy = f"give at most {MOST_BINS} steps, {MOST_BINS * dt_s:g} s, or longer steps"
            raise FieldError("DataCenters", "service.deadline_s", self.deadline_s, remedy)
        if self.deadline_s < dt_s:
            remedy = f"give at least one step, {dt_s:g} s"
            raise FieldError("DataCenters", "service.deadline_s", self.deadline_s, remedy)

    def slack(self, dt_s: float) -> tuple[int, int]:
        """Steps behind its own in which interactive and deferrable work may be served."""
        return int(self.target_s / dt_s + 1e-9), int(self.deadline_s / dt_s + 1e-9)


class ServiceState(NamedTuple):
    """State of the queues."""

    slack_kws: Array
    """Work by the steps that it has left, what is overdue first, kW s, (row, slot, bin); by age, the oldest first,
    where it is served first come first served."""
    overdue_kws: Array
    """Work that is overdue, kW s, (row, slot)."""
    due_next_kws: Array
    """Work due in the next step, without overdue work, kW s, (row, slot)."""


METRICS = (
    cost_metric("late", "cost of late work"),
    Metric("in_time_pct", "work in time", "%", 2, "higher", "share of work served within its target or deadline",
        tables=("run",)),
    Metric("interactive_in_time_pct", "interactive work in time", "%", 2, "higher",
        "share of interactive work served within its target"),
    Metric("deferrable_in_time_pct", "deferrable work in time", "%", 2, "higher",
        "share of deferrable work served within its deadline"),
    Metric("lateness_mean_s", "mean lateness", "s", 2, "lower",
        "mean lateness of work, 0 where in time, weighted by work"),
    Metric("lateness_p95_s", "95 % of work late by at most", "s", 1, "lower",
        "lateness that 95 % of the work does not exceed", tables=("run",), short="p95 lateness, s"),
)  # fmt: skip
"""Metrics of sites whose work has deadlines."""


@dataclass(frozen=True)
class ServedSites(PassiveFeature):
    """Sites with these service levels; behind all other features, so that it sees what was served in the end."""

    rule: ServiceLevels
    moves_late: bool = False
    """Whether work that was moved has a step less."""
    boost_share: float = 1.0
    """Highest draw of a site as a share of its rating."""

    amounts: ClassVar[tuple[str, ...]] = ("overdue_kws",)

    def fields(self, params: DataCenterParams, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """Return the fields for overdue work, and for work that becomes overdue unless the next step serves it."""
        rated, longest_s = params.p_rated_kw, self._longest_s(horizon, dt_s)
        return (
            Field("overdue", "s at the rating", 0.0, longest_s, rated),
            Field("due_next", "s at the rating", 0.0, longest_s, rated),
        )

    def cost_terms(self, params: DataCenterParams, horizon: int, dt_s: float) -> tuple[CostTerm, ...]:
        """Return the cost term of overdue work."""
        rated = params.p_rated_kw
        of_all = float(rated.sum()) or 1.0
        return (
            CostTerm(
                "late", "overdue_kws", rated, of_all, self._longest_s(horizon, dt_s), weight=self.rule.late_weight
            ),
        )

    def _longest_s(self, horizon: int, dt_s: float) -> float:
        """Most work of a site that can be overdue, s at the rating: its own, and as much again from other sites."""
        return (self.boost_share + 1.0) * horizon * dt_s

    def initial(self, params: DataCenterParams, zero: Array) -> ServiceState:
        """Empty queues, which need one bin alone."""
        return ServiceState(zero[..., None], zero, zero)

    def step(
        self,
        params: DataCenterParams,
        feature_state: ServiceState,
        site: DataCenterState,
        p_kw: Array,
        setpoints: tuple[Array, ...],
        inputs: FeatureInputs,
        dt_s: float,
    ) -> tuple[ServiceState, DataCenterState, Array]:
        """Take what was served out of the queue, see ``SiteFeature.step``."""
        soon, later = self.rule.slack(dt_s)
        queue = feature_state.slack_kws
        moved = inputs.load.moved_kw if inputs.load is not None and self.moves_late else None
        if queue.shape[-1] != later + 1:
            queue = namespace(queue).concat((queue,) * (later + 1), axis=-1)
        share, first = self.rule.interactive_share, self.rule.order == "edf"
        after = serve_by_slack(queue, moved, site.arrived_kw, site.served_kw, dt_s, soon, later, share, first)
        return ServiceState(*after), site, p_kw

    def observe(self, params: DataCenterParams, feature_state: ServiceState) -> tuple[Array, ...]:
        """Raw figures of ``fields``."""
        return feature_state.overdue_kws, feature_state.due_next_kws

    def amount(self, name: str, params: DataCenterParams, feature_state: ServiceState) -> Array:
        """What the term of ``cost_terms`` charges."""
        return feature_state.overdue_kws

    def totals(self, feature_state: ServiceState) -> dict[str, Array]:
        """Work that is overdue at all sites."""
        return {"overdue_kws": sum_last(feature_state.overdue_kws)}

    def metrics(
        self, params: DataCenterParams, history: SiteState, feature_state: ServiceState, dt_s: float
    ) -> dict[str, float]:
        """Figures of an episode, see ``core.metric``."""
        moved = history.received_kw if self.moves_late else np.zeros_like(history.arrived_kw)
        slack = self.rule.slack(dt_s)
        share, first = self.rule.interactive_share, self.rule.order == "edf"
        return lateness(history.arrived_kw[1:], moved[1:], history.served_kw[1:], slack, share, first, dt_s)

    def streaming(self, params: DataCenterParams, dt_s: float) -> _LatenessOfSites:
        """Accumulator of the figures of ``metrics`` over a course that comes in parts."""
        return _LatenessOfSites(self, dt_s)


class _LatenessOfSites:
    """Accumulates the figures of ``ServedSites`` for a streamed episode."""

    def __init__(self, sites: ServedSites, dt_s: float):
        self.moves_late = sites.moves_late
        rule = sites.rule
        self._late = StreamingLateness(rule.slack(dt_s), rule.interactive_share, rule.order == "edf", dt_s)

    def add(self, history: SiteState, feature_state: ServiceState) -> None:
        """Take a part."""
        moved = history.received_kw if self.moves_late else np.zeros_like(history.arrived_kw)
        self._late.add(history.arrived_kw[1:], moved[1:], history.served_kw[1:])

    def figures(self) -> dict[str, float]:
        """Those of all parts so far."""
        return self._late.figures()


@compiled_as("dcgrid_env.devices.datacenter.site_kernels:serve_by_slack", like="arrived_kw")
def serve_by_slack(
    queue_kws: Array,
    moved_kw: Array | None,
    arrived_kw: Array,
    served_kw: Array,
    dt_s: float,
    soon: int,
    later: int,
    interactive_share: float,
    by_deadline: bool,
) -> tuple[Array, Array, Array]:
    """The queue at the end of a step, what is overdue and what is due in the next step, kW s.

    Parameters
    ----------
    queue_kws
        That of before, (.., slot, later + 1).
    moved_kw
        What of the arriving work has a step less, (.., slot); None for nothing.
    arrived_kw, served_kw
        Work that arrives and that is served in the step, (.., slot).
    dt_s
        Length of the step, s.
    soon, later
        Steps that interactive and deferrable work have beyond that in which it arrives.
    interactive_share, by_deadline
        Share of the work that is interactive, and whether the earliest deadline comes first.
    """
    xp = namespace(arrived_kw)
    bins = np.zeros((2, later + 2))
    for slack, share in ((soon, interactive_share), (later, 1.0 - interactive_share)):
        due_step = slack + 1 if by_deadline else later + 1
        bins[0, due_step] += share
        bins[1, max(due_step - 1, 1)] += share
    arrived_share, moved_share = (as_like(row, queue_kws) for row in bins)
    local_kw = arrived_kw if moved_kw is None else arrived_kw - moved_kw
    x = xp.concat((queue_kws, 0.0 * queue_kws[..., :1]), axis=-1) + (local_kw * dt_s)[..., None] * arrived_share
    if moved_kw is not None:
        x = x + (moved_kw * dt_s)[..., None] * moved_share
    before = x.cumsum(-1) - x
    left = positive_part(x - positive_part((served_kw * dt_s)[..., None] - before))
    queue = xp.concat((left[..., :1] + left[..., 1:2], left[..., 2:]), axis=-1)
    return queue, *_due(queue, soon, later, interactive_share, by_deadline)


def _due(queue: Array, soon: int, later: int, share: float, by_deadline: bool) -> tuple[Array, Array]:
    """Return the overdue work, and the further work that is due in the next step."""
    if by_deadline:
        return queue[..., 0], queue[..., 1] + 0.0
    old, young = later - soon, 1.0 - share
    overdue = young * queue[..., 0] + share * sum_last(queue[..., : old + 1])
    next_due = queue[..., old + 1] if old + 1 <= later else 0.0 * overdue
    return overdue, young * queue[..., 1] + share * next_due
