"""Requests of a utility for the power of the data centres: caps and targets over time, one part of a scenario.

A request bounds the total draw P of the sites, as a share of the sum of their ratings, to a range:

    cap      P <= value
    target   P  = value

It begins with a ramp, over which the range narrows linearly from all that the sites can draw, and ends without one:

    upper(t) = highest + (value - highest) min((t - begin) / ramp, 1)        begin < t <= begin + duration
    lower(t) = lowest  + (value - lowest)  min((t - begin) / ramp, 1)        a target alone

Two public interfaces have such requests. The load targets of NVIDIA's DSX Exchange [1]_ have a power, a start and an
end; of two that overlap, the one scheduled last holds [2]_. EPRI's DCFlex demonstrates reductions over hours [3]_.

References
----------
.. [1] NVIDIA, "DSX Exchange: power management, schemas", docs.nvidia.com/dsx-exchange/schema/power-management/schemas.
.. [2] NVIDIA, "Domain Power Service: NvGrid", docs.nvidia.com/datacenter/dps/versions/latest/guides/concepts/nvgrid.
.. [3] P. Colangelo et al., "Turning AI data centers into grid-interactive assets: results from a field demonstration
   in Phoenix, Arizona", arXiv 2507.00909, 2025.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from dcgrid_env.core.checked import FieldError, choice, count, number, parts, refuse, settle, span

RequestKind = Literal["cap", "target"]

Range = tuple[float, float]
"""A lowest and a highest value, between which an episode draws evenly."""


@dataclass(frozen=True, kw_only=True)
class LoadTarget:
    """One request of a utility, drawn in each episode within its ranges; a single number is a range without width.

    Exactly one of ``value_share`` and ``value_mw`` is given.
    """

    kind: RequestKind = choice("cap", "target", default="cap")
    """Kind of request: "cap", a most for the total draw of the sites, or "target", a value for it."""
    value_share: Range | None = span(0.0, 10.0, default=None)
    """Lowest and highest requested draw, as a share of the sum of the sites' ratings."""
    value_mw: Range | None = span(0.0, 1e6, default=None)
    """Lowest and highest requested draw, MW."""
    begin_s: Range = span(0.0, 1e9, default=(0.0, 0.0))
    """Earliest and latest start, s from the episode's; a request after the episode's end does not happen."""
    ramp_s: Range = span(0.0, 1e9, default=(0.0, 0.0))
    """Shortest and longest time from the start until the value holds, s."""
    duration_s: Range = span(0.0, 1e9, default=(3600.0, 3600.0))
    """Shortest and longest time from the start to the end, s, with the ramp."""
    priority: int = count(0, 1000, default=0)
    """Rank: of several requests in force, that of the highest priority holds, and of equals that which started last."""

    def __post_init__(self) -> None:
        settle(self)
        if (self.value_share is None) == (self.value_mw is None):
            remedy = "give value_share, a share of the sites' ratings, or value_mw, and not both"
            raise refuse(self, "value_share", remedy)
        if self.duration_s[0] <= 0.0:
            raise refuse(self, "duration_s", "give a shortest above 0 s, or leave the request out")


@dataclass(frozen=True, kw_only=True)
class GridRequest:
    """Requests of a utility for the total draw of the data centres. By default there are none."""

    targets: tuple[LoadTarget, ...] = parts(LoadTarget)
    """Requests, each a :class:`LoadTarget` or a mapping of its fields; () for none."""
    notice_s: float = number(0.0, 1e9, default=60.0)
    """Time before its start from which agents observe a request, s."""
    tolerance_share: float = number(0.0, 1.0, default=0.01)
    """Distance from a request up to which the metric of compliance counts it as met, share of the sites' ratings."""

    def __post_init__(self) -> None:
        settle(self)


def check_grid_request(scenario: Any) -> None:
    """Raise FieldError for requests without a site, beyond what sites can draw, or with a weight and no request."""
    request, weight = scenario.grid_request, scenario.cost.weights.grid_request
    if not request.targets:
        if weight:
            remedy = "give grid_request.targets too, whose excess it weighs, or set it to 0"
            raise FieldError("Scenario", "cost.weights.grid_request", weight, remedy)
        return
    if not scenario.n_sites:
        remedy = "leave it out: the scenario has no data centre"
        raise FieldError("Scenario", "grid_request.targets", request.targets, remedy)
    rated_mw = float(scenario.site_rated_kw.sum()) / 1000.0
    _, highest = draw_range(scenario)
    for i, target in enumerate(request.targets):
        name, value, most, unit = "value_share", target.value_share, highest, ""
        if value is None:
            name, value, most, unit = "value_mw", target.value_mw, highest * rated_mw, " MW"
        if value[1] > most * (1.0 + 1e-9):
            remedy = f"give at most {most:g}{unit}, which is all that the sites can draw"
            raise FieldError("Scenario", f"grid_request.targets[{i}].{name}", value, remedy)


def draw_range(scenario: Any) -> Range:
    """Return the lowest and highest total draw that the sites are capable of, as shares of the sum of their ratings."""
    groups = [device for device in scenario.devices if device.input == "workload"]
    lowest = 0.0 - max((getattr(group, "largest_export_share", 0.0) for group in groups), default=0.0)
    return float(lowest), float(max((group.largest_draw_share for group in groups), default=1.0))
