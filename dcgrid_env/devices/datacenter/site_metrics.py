"""Figures of an episode of data centres: waiting times, clocks, and times of requests where there are any."""

from __future__ import annotations

from dcgrid_env.core.metric import Metric
from dcgrid_env.devices.datacenter.clock_law import Dvfs, speed_share
from dcgrid_env.devices.datacenter.moved_requests import by_site
from dcgrid_env.devices.datacenter.request_delay import request_delays, serve_requests
from dcgrid_env.devices.datacenter.waiting_time import Delays, fcfs_delays
from dcgrid_env.devices.device import DeviceState, Requests
from dcgrid_env.devices.ratings import DataCenterParams
from dcgrid_env.traces import RequestTimes

METRICS = (
    Metric("delay_mean_s", "mean delay", "s", 2, "lower",
        "mean waiting time of work, first come first served in each class, weighted by work",
        tables=("run", "evaluate", "benchmark", "check")),
    Metric("delay_p50_s", "50 % of work within", "s", 1, "lower",
        "waiting time that 50 % of the work does not exceed", short="p50 delay, s"),
    Metric("delay_p95_s", "95 % of work within", "s", 1, "lower",
        "waiting time that 95 % of the work does not exceed", tables=("run",), short="p95 delay, s"),
    Metric("delay_p99_s", "99 % of work within", "s", 1, "lower",
        "waiting time that 99 % of the work does not exceed", tables=("run", "evaluate", "benchmark"),
        short="p99 delay, s"),
    Metric("requests_sampled", "requests sampled", "", 0, "neither",
        "number of requests that the figures are over: an even sample of sources of many requests a second"),
    Metric("requests_unfinished_pct", "requests unfinished", "%", 1, "lower",
        "share of those requests with work still queued at the end"),
    Metric("ttft_mean_s", "time to first token, mean", "s", 2, "lower", "mean time from arrival to the first token",
        tables=("run",)),
    Metric("ttft_p50_s", "time to first token, 50 %", "s", 2, "lower", "the same, median"),
    Metric("ttft_p95_s", "time to first token, 95 %", "s", 2, "lower", "the same, 95 % quantile"),
    Metric("ttft_p99_s", "time to first token, 99 %", "s", 2, "lower", "the same, 99 % quantile", tables=("run",)),
    Metric("e2e_mean_s", "end to end, mean", "s", 2, "lower", "mean time from arrival to the last token",
        tables=("run",)),
    Metric("e2e_p50_s", "end to end, 50 %", "s", 2, "lower", "the same, median"),
    Metric("e2e_p95_s", "end to end, 95 %", "s", 2, "lower", "the same, 95 % quantile"),
    Metric("e2e_p99_s", "end to end, 99 %", "s", 2, "lower", "the same, 99 % quantile", tables=("run",)),
    Metric("arrived_kws", "work that arrived", "kW s", 1, "neither", "work that arrived"),
    Metric("unserved_kws", "unserved at the end", "kW s", 1, "lower", "work that was still queued at the end",
        tables=("run", "evaluate", "benchmark"), short="unserved, kW s"),
    Metric("clock_mean_pct", "mean clock", "% of the top clock", 1, "higher",
        "mean clock as a share of the top clock", "mean"),
)  # fmt: skip
"""Metrics of data centres."""


def site_metrics(
    params: DataCenterParams,
    clock_law: Dvfs,
    history: DeviceState,
    dt_s: float,
    requests: Requests,
    latency_s: float = 0.0,
) -> dict[str, float]:
    """Figures by name, see ``Device.metrics``; ``history`` has the fields of ``DataCenterState`` over time, and
    ``latency_s`` is that of a move between sites."""
    arrived, served = (w[1:].reshape(len(w) - 1, -1) for w in (history.class_arrived_kw, history.class_served_kw))
    figures = delay_figures(fcfs_delays(arrived, served, dt_s)) | {"clock_mean_pct": mean_clock_pct(params, history)}
    if requests:
        figures |= request_figures(params, clock_law, history, dt_s, requests, latency_s)
    return figures


def delay_figures(delays: Delays) -> dict[str, float]:
    """Figures of waiting times, by name."""
    return {
        "delay_mean_s": delays.mean_s,
        "delay_p50_s": delays.p50_s,
        "delay_p95_s": delays.p95_s,
        "delay_p99_s": delays.p99_s,
        "arrived_kws": delays.arrived_kws,
        "unserved_kws": delays.unserved_kws,
    }


def mean_clock_pct(params: DataCenterParams, history: DeviceState) -> float:
    """Mean clock of all sites as a share of the top clock, which is one for all."""
    clock = history.f_mhz[1:].mean() / params.f_max_mhz[0] if len(params.f_max_mhz) else 1.0
    return 100.0 * clock


def request_figures(
    params: DataCenterParams,
    clock_law: Dvfs,
    history: DeviceState,
    dt_s: float,
    requests: list[tuple[RequestTimes, float]],
    latency_s: float,
) -> dict[str, float]:
    """Figures over the requests of all sites, see ``site_metrics``."""
    parts = (history.class_arrived_kw[1:], history.class_served_kw[1:])
    arrived, served = (w.reshape(*w.shape[:2], -1) for w in parts)
    speed = speed_share(clock_law, params, history.f_mhz[1:])
    wait_s = getattr(history, "batch_wait_s", 0.0 * history.f_mhz)[1:]
    return request_delays(
        serve_requests(
            times, begin_s, arrived[:, i], served[:, i], speed[:, i], dt_s, wait_s[:, i] + latency_s * (i != came_to)
        )
        for times, begin_s, i, came_to in by_site(requests, history, dt_s)
    )._asdict()
