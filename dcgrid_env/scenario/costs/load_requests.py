"""Cost and metrics of a utility's requests for the total draw of the sites (``scenario.grid_request``).

    missed_t = max(P_t - upper_t, 0) + max(lower_t - P_t, 0)          shares of the sum of the sites' ratings

P is the draw of all sites at the grid. Without a request the range from lower to upper is all that the sites can draw,
and nothing is missed. At weight w, a MW that is missed for a second costs w / (sum of the ratings in MW), as a MW s of
backlog does at the weight of the backlog.

The metric of what was asked for compares the request with ``reference``, what the sites would draw at the top clock
with nothing queued.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, positive_part, sum_last
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.metric import Metric
from dcgrid_env.scenario.costs.utility_limits import sites
from dcgrid_env.scenario.grid_request import draw_range


class RequestColumns(NamedTuple):
    """Columns of ``State.request``: shares of the sum of the sites' ratings unless stated otherwise, (row,) each."""

    lower: Array
    """Least total draw that was requested over the interval; what the sites can draw at least without a request."""
    upper: Array
    """Most total draw that was requested over it."""
    reference: Array
    """What the sites would have drawn over it at the top clock with nothing queued."""
    lower_next: Array
    """Least total draw that is requested over the coming interval."""
    upper_next: Array
    """Most total draw that is requested over it."""
    left: Array
    """Time until that request ends, share of the notice, 1 at most; 0 without a request."""
    wait: Array
    """Time until the next request that is announced begins, share of the notice; 1 if none is announced."""
    lower_announced: Array
    """Least total draw of that request behind its ramp; what the sites can draw at least if none is announced."""
    upper_announced: Array
    """Most total draw of that request behind its ramp."""


def columns(request: Array) -> RequestColumns:
    """Return the columns of ``State.request``, (row, n_column), by name."""
    return RequestColumns(*(request[..., i] for i in range(len(RequestColumns._fields))))


METRICS = (
    Metric("grid_request_compliance_pct", "requests met", "% of time", 1, "higher",
        "share of the steps with a request of the utility in which the sites' draw met it within the tolerance; 100 "
        "without such steps", "mean", tables=("run",)),
    Metric("grid_request_asked_kwh", "reduction asked for", "kWh", 2, "neither",
        "energy by which the sites' draw at the top clock with nothing queued lies beyond the requests", "sum",
        tables=("run",)),
    Metric("grid_request_delivered_kwh", "reduction delivered", "kWh", 2, "higher",
        "the same less what the draw itself lies beyond the requests, at least 0 in each step", "sum",
        tables=("run",)),
    Metric("grid_request_missed_max_kw", "largest miss of a request", "kW", 1, "lower",
        "largest distance of the sites' draw from a request", "max", over_episodes="max", tables=("run",)),
)  # fmt: skip
"""Metrics of requests, in scenarios that have any."""


@cached_on_owner
def rated_kw(scenario: Any) -> float:
    """Sum of the sites' ratings, kW."""
    return float(scenario.site_rated_kw.sum())


def sites_share(scenario: Any, p_kw: Array) -> Array:
    """Total draw of the sites as a share of the sum of their ratings, (row,), of the agents' draws, (row, n_agent)."""
    return sum_last(p_kw[..., sites(scenario)]) / rated_kw(scenario)


def missed_share(draw: Array, lower: Array, upper: Array) -> Array:
    """Distance of a draw from the range that is requested, all shares, elementwise."""
    return positive_part(draw - upper) + positive_part(lower - draw)


def missed(scenario: Any, state: Any) -> Array:
    """Distance of the sites' draw from the request over a step, as a share of the sum of their ratings, (row,).

    ValueError for a state of a scenario without requests.
    """
    if state.request is None:
        raise ValueError(f"scenario {scenario.name!r} has no request of a utility; give it grid_request.targets")
    request = columns(state.request)
    return missed_share(sites_share(scenario, state.p_kw), request.lower, request.upper)


def largest_missed(scenario: Any) -> float:
    """Upper bound of that distance: from one end of what the sites can draw to the other."""
    lowest, highest = draw_range(scenario)
    return highest - lowest


def request_figures(scenario: Any, p_kw: np.ndarray, request: np.ndarray | None) -> tuple[dict[str, float], int]:
    """Metrics of the steps 1 .. T, and in how many of them there was a request; none where ``request`` is None.

    Parameters
    ----------
    scenario
        The scenario.
    p_kw
        Draws of the agents, kW, (T, n_agent).
    request
        ``State.request`` of these steps, (T, n_column).
    """
    if request is None:
        return {}, 0
    asked, (lowest, highest) = columns(request), draw_range(scenario)
    short = missed_share(sites_share(scenario, p_kw), asked.lower, asked.upper)
    due = missed_share(asked.reference, asked.lower, asked.upper)
    requested = (asked.lower > lowest) | (asked.upper < highest)
    met = short <= scenario.grid_request.tolerance_share + 1e-9
    kwh = rated_kw(scenario) * scenario.dt_s / 3600.0
    n = int(requested.sum())
    return {
        "grid_request_compliance_pct": 100.0 * float(met[requested].mean()) if n else 100.0,
        "grid_request_asked_kwh": kwh * float(due.sum()),
        "grid_request_delivered_kwh": kwh * float(np.maximum(due - short, 0.0).sum()),
        "grid_request_missed_max_kw": rated_kw(scenario) * float(short.max(initial=0.0)),
    }, n
