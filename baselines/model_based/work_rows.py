"""Rows for work that is routed or has deadlines in the linear program of an episode.

Routed work (``devices.datacenter.work_routing``):

    over      o, y   work that each site sends and receives, kW
    with      o <= m a,  y <= P,  sum_i y = sum_i o          a: what arrives there, P: dynamic power at the rating
              b_t = b_{t-1} + (a_t - o_t + y_t - d_t) dt

Service levels (``devices.datacenter.service_levels``), earliest deadline first:

    over      i, h   interactive work served, kW, and queued, kW s           the rest of d and b is deferrable
              l, k   interactive and deferrable work that is overdue, kW s
    with      h_t = h_{t-1} + (phi (a_t - o_t + y_t) - i_t) dt,  i <= d,  h <= b
              l_t >= h_t - phi (a - o + y) dt summed over the last steps in which it is in time, and so k of b - h

The order that costs least is the earliest deadline first, since all overdue work has one price. First come first served
has h = phi b, and neither i nor h. Moved work has one step less until its deadline.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from dcgrid_env import Scenario

Part = tuple[dict[str, Any], np.ndarray]  # parts of rows by their unknowns, and what each row is, or is at most


class WorkRows:
    """Routing and service levels of a scenario in the program of an episode; nothing at all where it has neither.

    Parameters
    ----------
    scenario
        With its data centres before all other agents.
    arrived_kw
        Work that arrives at each site, kW, (T, n_dc).
    available
        1 for an agent that is connected to the grid and 0 for one that is not, (T, n_agent).
    """

    def __init__(self, scenario: Scenario, arrived_kw: np.ndarray, available: np.ndarray) -> None:
        group = scenario.datacenters
        self.routing = getattr(group, "routing", None) if group.count else None
        self.service: Any = getattr(group, "service", None) if group.count else None
        self.steps, self.n = arrived_kw.shape
        self.dt_s, self.arrived_kw = scenario.dt_s, arrived_kw
        self.rated_kw = float(scenario.datacenters.parameters.p_rated_kw.sum()) or 1.0
        size = self.steps * self.n
        moved, served = size * (self.routing is not None), size * (self.service is not None)
        split = served if self.service is not None and self.service.order == "edf" else 0
        self.sizes = {"y": moved, "o": moved, "i": split, "h": split, "l": served, "k": served}
        """Number of unknowns of each name."""
        self.room_kw = scenario.datacenters.parameters.p_dynamic_kw * available[:, : self.n]
        movable = self.routing.movable_share if self.routing is not None else 0.0
        self.movable_kw = movable * arrived_kw
        """Most that each site may send, kW, (T, n_dc)."""

    def ranges(self) -> dict[str, tuple[Any, Any]]:
        """Least and largest value of the unknowns."""
        if self.routing is None:
            return {}
        return {"y": (0.0, self.room_kw.ravel()), "o": (0.0, self.movable_kw.ravel())}

    def prices(self) -> dict[str, float]:
        """What each unknown costs, as shares of J times T."""
        prices = {}
        if self.routing is not None:
            prices["y"] = self.routing.move_weight * self.routing.move_latency_s / self.rated_kw
        if self.service is not None:
            prices |= dict.fromkeys(("l", "k"), self.service.late_weight / self.rated_kw)
        return prices

    def moved(self) -> dict[str, Any]:
        """What the moves take off the left side of the conservation of a site's queue, kW s."""
        if self.routing is None:
            return {}
        one = self.dt_s * sparse.identity(self.sizes["y"], format="csr")
        return {"y": -one, "o": one}

    def equalities(self) -> list[Part]:
        """All that is sent is received, and the queue of interactive work."""
        parts: list[Part] = []
        if self.routing is not None:
            of_step = sparse.kron(sparse.identity(self.steps), np.ones((1, self.n)), format="csr")
            parts.append(({"y": of_step, "o": -of_step}, np.zeros(self.steps)))
        if self.sizes["h"]:
            one = sparse.identity(self.sizes["h"], format="csr")
            share, step = self.service.interactive_share, one - sparse.eye(self.sizes["h"], k=-self.n, format="csr")
            moved = {name: share * part for name, part in self.moved().items()}
            queue = {"h": step, "i": self.dt_s * one, **moved}
            parts.append((queue, share * self.dt_s * self.arrived_kw.ravel()))
        return parts

    def limits(self, in_d: sparse.csr_array) -> list[Part]:
        """Interactive work is part of all, and what is queued beyond the steps in time is overdue; ``in_d`` picks the
        work served among d."""
        if self.service is None:
            return []
        one = sparse.identity(self.steps * self.n, format="csr")
        zero = np.zeros(self.steps * self.n)
        parts: list[Part] = []
        share, slack = self.service.interactive_share, self.service.slack(self.dt_s)
        queues: tuple[dict[str, Any], ...] = ({"b": share * one}, {"b": (1.0 - share) * one})
        if self.sizes["h"]:
            parts += [({"i": one, "d": -in_d}, zero), ({"h": one, "b": -one}, zero)]
            queues = ({"h": one}, {"b": one, "h": -one})
        for name, queue, of_kind, steps in zip("lk", queues, (share, 1.0 - share), slack, strict=True):
            recent = of_kind * self.dt_s * self._last(steps)
            rows = {name: -one, **queue}
            if self.routing is not None:
                less = max(steps - (self.routing.move_latency_s > 0.0), 0)
                rows |= {"o": recent, "y": -of_kind * self.dt_s * self._last(less)}
            parts.append((rows, recent @ self.arrived_kw.ravel()))
        return parts

    def _last(self, steps: int) -> Any:
        """What sums over so many steps up to each."""
        window = np.tri(self.steps) - np.tri(self.steps, k=-steps)
        return sparse.kron(sparse.csr_matrix(window), sparse.identity(self.n), format="csr")

    def route(self, net: np.ndarray) -> np.ndarray:
        """Setpoints of the channel ``route`` by which sites receive so much more than they send, kW, (T, n_dc)."""
        taken = np.divide(net, self.room_kw, out=np.zeros_like(net), where=(net > 0.0) & (self.room_kw > 0.0))
        sent_share = np.divide(
            net, self.movable_kw, out=np.zeros_like(net), where=(net < 0.0) & (self.movable_kw > 0.0)
        )
        return np.clip(taken + sent_share, -1.0, 1.0)
