"""Requests whose work is moved between sites: the serving site, and waits in addition to the queue's.

Work is a fluid, and requests are followed one by one to find their delays. In each step, the share of a site's requests
that moves equals the share of its work that moves, spread evenly among the requests. The receiving sites get them in
proportion to the work that they receive. Each request is then served in the queue of its new site.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dcgrid_env.devices.device import DeviceState
from dcgrid_env.traces import RequestTimes

_EVENLY = (0.6180339887498949, 0.7548776662466927)  # multiples of either, less whole numbers, fill 0 .. 1 evenly


def by_site(
    requests: list[tuple[RequestTimes, float]], history: DeviceState, dt_s: float
) -> Iterator[tuple[RequestTimes, float, int, int]]:
    """Requests, where their episode begins among them, s, the site that serves them and that at which they arrived.

    Parameters
    ----------
    requests
        Those of each site's trace and where the episode begins among them, s.
    history
        State of the sites over time, (T + 1, slot).
    dt_s
        Length of a step, s.
    """
    sent = getattr(history, "sent_kw", None)
    if sent is None:
        yield from ((times, begin_s, site, site) for site, (times, begin_s) in enumerate(requests))
        return
    sent, received = sent[1:], history.received_kw[1:]
    came = history.arrived_kw[1:] - received + sent
    gone = np.divide(sent, came, out=np.zeros_like(sent), where=came > 0.0)
    to = np.cumsum(received, axis=1)
    for site, (times, begin_s) in enumerate(requests):
        step = np.floor((times.arrival_s - begin_s) / dt_s).astype(np.int64)
        inside = (step >= 0) & (step < len(sent))
        step = np.clip(step, 0, len(sent) - 1)
        number = np.arange(len(step))
        is_moved = inside & ((number * _EVENLY[0]) % 1.0 < gone[step, site])
        level = ((number * _EVENLY[1]) % 1.0) * to[step, -1]
        served_at = np.where(is_moved, np.minimum((to[step] <= level[:, None]).sum(axis=1), sent.shape[1] - 1), site)
        for other in np.union1d(served_at[inside], [site]):
            taken = inside & (served_at == other)
            yield RequestTimes(*(of_each[taken] for of_each in times)), begin_s, int(other), site
