"""Request sharing: the sites meet a utility's request for their total draw together, in addition to the droop.

    base      = sum_i min(p_ref_i, p_idle_i)                draw that no clock changes
    ready_i   = what the droop's clock lets site i serve of its arriving and queued work
    need_i    = a_i + g b_i                                 a: arriving work, kW; b: queued work, kW s
    d_i       = least_i + min(lambda need_i, ready_i - least_i)

At its lowest clock a site serves least. If base + sum ready exceeds the upper bound of the request, lambda makes
base + sum d equal to the bound, so sites with more work keep more of their draw. If it is less than the lower bound,
sites serve more of their queues than under the droop, in proportion to what they can add.

A request that is announced counts before it starts: over the time ``advance_s`` before its start the most draw falls
linearly to its value. Where the scenario hides p_ref the rating replaces it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dcgrid_env import Scenario, field_names
from dcgrid_env.baselines.controller import Local
from dcgrid_env.baselines.laws.droop import Droop
from dcgrid_env.baselines.parameter_checks import require_non_negative
from dcgrid_env.devices import site_work


class Request(NamedTuple):
    """What sites observe of requests: shares of the sum of their ratings, and a share of the notice, (...,) each."""

    request_lower: np.ndarray
    request_upper: np.ndarray
    request_wait: np.ndarray
    coming_upper: np.ndarray


@dataclass
class RequestSharing(Droop):
    """Sharing of a utility's request among the sites. Further parameters are those of the droop.

    Parameters
    ----------
    backlog_weight_per_s
        Weight of queued work against arriving work when the sites share a cap, 1/s (g above).
    advance_s
        Time before the start of a request over which the sites lower their draw, s; 0 for none. The notice of the
        scenario limits it.
    """

    backlog_weight_per_s: float = 0.2
    advance_s: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_non_negative(
            "request-sharing", backlog_weight_per_s=self.backlog_weight_per_s, advance_s=self.advance_s
        )

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes; ValueError for a scenario without requests of a utility."""
        super().reset(env_info)
        if not has_requests(env_info):
            raise ValueError(
                f"request-sharing: scenario {env_info.name!r} has no request of a utility; give it "
                "grid_request={'targets': [..]}, or use the law 'droop'"
            )
        flat = [(agent, name) for agent, names in field_names(self.scenario).items() for name in names]
        self._request_at = [flat.index(("dc_0", name)) for name in Request._fields]

    def _act(self, joint: np.ndarray) -> np.ndarray:
        local = self._local(joint)
        f_mhz, q_kvar = self.control(local)
        request = Request(*(joint[..., column].astype(np.float64) for column in self._request_at))
        return self._joint(self._shared_clocks(local, request, f_mhz), q_kvar, self.draw(local))

    def _shared_clocks(self, local: Local, request: Request, f_mhz: np.ndarray) -> np.ndarray:
        """Return the clocks of the sites that meet the request, MHz, (..., n_dc), from those of the droop."""
        s, dc = self.scenario, self.scenario.datacenters.parameters
        p_ref_kw = local.p_ref_next_kw if s.sensing.preview else np.broadcast_to(dc.p_rated_kw, f_mhz.shape)
        arriving_kw = site_work.arriving(dc.p_idle_kw, p_ref_kw)
        most_kw = np.minimum(site_work.at_hand(local.backlog_kws, arriving_kw, s.dt_s), dc.p_dynamic_kw)
        least_kw = np.minimum(most_kw, dc.p_dynamic_kw * (dc.f_min_mhz / dc.f_max_mhz))
        ready_kw = np.clip(dc.p_dynamic_kw * f_mhz / dc.f_max_mhz, least_kw, most_kw)
        idle_kw = site_work.idle_draw(dc.p_idle_kw, p_ref_kw).sum(-1)
        lower_kw, upper_kw = (share * dc.p_rated_kw.sum() - idle_kw for share in self._bounds(request))
        need_kw = arriving_kw + self.backlog_weight_per_s * local.backlog_kws
        served_kw = least_kw + shared(upper_kw - least_kw.sum(-1), need_kw, ready_kw - least_kw)
        served_kw = served_kw + shared(lower_kw - served_kw.sum(-1), most_kw - served_kw, most_kw - served_kw)
        is_moved = np.abs(served_kw - ready_kw) > 1e-9 * dc.p_rated_kw
        f_mhz = np.where(is_moved, served_kw / dc.p_dynamic_kw * dc.f_max_mhz, f_mhz)
        return np.clip(f_mhz, dc.f_min_mhz, dc.f_max_mhz)

    def _bounds(self, request: Request) -> tuple[np.ndarray, np.ndarray]:
        """Return the least and most draw of the coming interval, with the ramp in advance; shares, (...,) each."""
        lower, upper, notice_s = request.request_lower, request.request_upper, self.scenario.grid_request.notice_s
        if min(self.advance_s, notice_s) == 0.0:
            return lower, upper
        highest = self.scenario.datacenters.largest_draw_share
        near = np.clip(1.0 - request.request_wait * notice_s / min(self.advance_s, notice_s), 0.0, 1.0)
        upper = np.minimum(upper, highest + (request.coming_upper - highest) * near)
        return np.minimum(lower, upper), upper


def shared(budget: np.ndarray, weights: np.ndarray, most: np.ndarray) -> np.ndarray:
    """Share a budget in proportion to weights, where no share may be above its most.

    Parameters
    ----------
    budget
        What is shared at most, (...,), nothing where it is negative.
    weights, most
        Weight of each share and the most that it may be, (..., n), at least 0.

    Returns
    -------
    np.ndarray
        The shares, (..., n). Their sum is the budget, or less where all weighted shares are at their most.
    """
    left = np.maximum(budget, 0.0)[..., None]
    full = np.zeros(most.shape, bool)
    shares = np.zeros(most.shape)
    for _ in range(most.shape[-1]):  # each pass fills a share at least, or is the last
        free = np.where(full, 0.0, weights)
        total = free.sum(-1, keepdims=True)
        rest = np.maximum(left - np.where(full, most, 0.0).sum(-1, keepdims=True), 0.0)
        wanted = np.divide(free * rest, total, out=np.zeros(most.shape), where=total > 0.0)
        shares = np.where(full, most, np.minimum(wanted, most))
        full = full | (wanted >= most) & (weights > 0.0)
    return np.minimum(shares, most)


def has_requests(scenario: Scenario) -> bool:
    """Whether a utility requests anything of the sites of a scenario."""
    return bool(scenario.grid_request.targets)
