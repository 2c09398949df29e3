"""Delays of single requests, from the fluid queue of their work and the clock at which they are served.

The trace gives a request's times at the top clock: arrival, first token, last token and the duration of its prefill.
Work of a class that would be done at time tau at the top clock is done when the cumulative served work S reaches the
cumulative arrived work A. Both are linear within a step, and service is first come first served. Service takes longer
at a lower clock, by the law's speed_c and speed_m as shares of those at the top clock:

    D(tau) = max(S^-1(A(tau)) - tau, 0)
    B_c    = prefill (1 / speed_c - 1)                       at the clock of the step in which the first token is due
    B_m    = integral of (1 / speed_m - 1) from the first token to the last

    time to first token = first token + D_c(arrival + first token) + B_c
    end to end          = last token + max(D_c(arrival + first token), D_m(arrival + last token)) + B_c + B_m

D_c is that of compute-bound work (prefill), D_m that of memory-bound work (decode); with one class they are the same.
B_c also includes the additional wait for a batch compared with the trace, if sites have batches, and the latency of a
request that is moved between sites (``moved_requests``).

Work that is never served counts as done at the end of the episode. An instant beyond the end has the delay and the
clock of the end. Such delays are underestimated; ``requests_unfinished_pct`` reports how many requests had work queued
at the end.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from dcgrid_env.traces import RequestTimes


class Served(NamedTuple):
    """Requests of one site over an episode, arrays (n,)."""

    ttft_s: np.ndarray
    """Time to first token, s."""
    e2e_s: np.ndarray
    """End to end, s."""
    unfinished: np.ndarray
    """Whether work of the request is still queued at the end, bool."""


class RequestDelays(NamedTuple):
    """Figures over requests; delays are 0 where there are none."""

    requests_sampled: int
    requests_unfinished_pct: float
    ttft_mean_s: float
    ttft_p50_s: float
    ttft_p95_s: float
    ttft_p99_s: float
    e2e_mean_s: float
    e2e_p50_s: float
    e2e_p95_s: float
    e2e_p99_s: float


def serve_requests(
    requests: RequestTimes,
    begin_s: float,
    arrived_kw: np.ndarray,
    served_kw: np.ndarray,
    speed_share: np.ndarray,
    dt_s: float,
    wait_s: np.ndarray | float = 0.0,
) -> Served:
    """Delays of the requests that arrive during an episode of one site.

    Parameters
    ----------
    requests
        Those of the site's whole trace, in the order of arrival.
    begin_s
        Where on the trace's time axis the first step begins, s.
    arrived_kw, served_kw
        Work that arrived and was served in each step, (n_step, n_class), compute-bound first.
    speed_share
        Speed of each work class at the clock of each step, share of that at the top clock, (n_step, n_class).
    dt_s
        Length of a step, s.
    wait_s
        What a request waits besides for its first token, by the step in which it is due, s, (n_step,) or one number.
    """
    first, last = np.searchsorted(requests.arrival_s, (begin_s, begin_s + len(arrived_kw) * dt_s))
    taken = RequestTimes(*(times[first:last] for times in requests))
    arrival_s = taken.arrival_s - begin_s
    first_s, end_s = arrival_s + taken.first_token_s, arrival_s + taken.end_s
    prefill_s, prefill_left = _delay(first_s, arrived_kw[:, 0], served_kw[:, 0], dt_s)
    decode_s, decode_left = _delay(end_s, arrived_kw[:, -1], served_kw[:, -1], dt_s)
    slower = 1.0 / speed_share - 1.0
    begin_step = np.clip((first_s / dt_s).astype(np.int64), 0, len(slower) - 1)
    reading_s = taken.prefill_s * slower[begin_step, 0] + np.broadcast_to(wait_s, len(slower))[begin_step]
    answering_s = _integral(end_s, slower[:, -1], dt_s) - _integral(first_s, slower[:, -1], dt_s)
    return Served(
        ttft_s=taken.first_token_s + prefill_s + reading_s,
        e2e_s=taken.end_s + np.maximum(prefill_s, decode_s) + reading_s + answering_s,
        unfinished=prefill_left | decode_left,
    )


def _integral(to_s: np.ndarray, figure: np.ndarray, dt_s: float) -> np.ndarray:
    """Integral of a figure that is constant in each step, (n_step,), from the beginning to ``to_s`` (n,), and keeps its
    last value afterwards."""
    edge_s = dt_s * np.arange(len(figure) + 1)
    inside = np.interp(to_s, edge_s, np.concatenate(([0.0], np.cumsum(figure) * dt_s)))
    return inside + figure[-1] * np.maximum(to_s - edge_s[-1], 0.0)


def request_delays(sites: Iterable[Served]) -> RequestDelays:
    """Figures over the requests of all sites; the q-quantile is the least delay that the share q does not exceed."""
    ttft_s, e2e_s, unfinished = (np.concatenate(columns) for columns in zip(*sites, strict=True))
    share = 100.0 * float(unfinished.mean()) if len(unfinished) else 0.0
    return RequestDelays(len(unfinished), share, *_figures(ttft_s), *_figures(e2e_s))


def _delay(tau_s: np.ndarray, arrived_kw: np.ndarray, served_kw: np.ndarray, dt_s: float) -> tuple[np.ndarray, ...]:
    """D at the instants ``tau_s`` after the first step begins, s, and whether that work is still queued at the end."""
    edge_s = dt_s * np.arange(len(arrived_kw) + 1)
    arrived, served = (np.concatenate(([0.0], np.cumsum(work))) for work in (arrived_kw, served_kw))
    tau_s = np.minimum(tau_s, edge_s[-1])
    # Without the rounding of the sums, work just served might seem to wait for the next that is.
    level = np.interp(tau_s, edge_s, arrived) - 1e-9 * arrived[-1]
    after = np.searchsorted(served, level)  # the first edge by which it has been served; none if beyond the last
    left = after == len(served)
    before = np.clip(after - 1, 0, len(served) - 2)
    step = served[before + 1] - served[before]
    part = np.divide(level - served[before], step, out=np.zeros_like(level), where=step > 0)
    done_s = edge_s[before] + dt_s * np.clip(part, 0.0, 1.0)
    return np.where(left, edge_s[-1] - tau_s, np.maximum(done_s - tau_s, 0.0)), left


def _figures(delay_s: np.ndarray) -> tuple[float, ...]:
    """Mean, p50, p95 and p99."""
    if not delay_s.size:
        return (0.0,) * 4
    quantiles = np.quantile(delay_s, (0.5, 0.95, 0.99), method="inverted_cdf")
    return (float(delay_s.mean()), *quantiles.tolist())
