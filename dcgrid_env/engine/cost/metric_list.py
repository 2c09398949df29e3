"""Every metric of an episode. The records are next to the functions that compute them.

Metrics of requests are over those that arrived in the episode at any site; all are 0 if none did. Metrics of storage,
of devices that may leave the grid, of smoothing, routing, batching, service levels and requests of a utility are there
where a scenario has such. Names that begin with ``site_`` are of storage behind the converters of data centres.
"""

from __future__ import annotations

from dcgrid_env.core.metric import Metric, cost_metric
from dcgrid_env.devices.datacenter import feature_settings, site_metrics
from dcgrid_env.devices.ride_through import riding_inverter
from dcgrid_env.devices.storage.figures import metrics_of
from dcgrid_env.engine.cost import fluctuation, grid_metrics
from dcgrid_env.scenario.costs import load_requests, overload
from dcgrid_env.scenario.costs.grid_terms import TERMS

_METRICS = (
    *grid_metrics.VOLTAGES,
    *(cost_metric(term.name, term.label, term.tables) for term in TERMS),
    *site_metrics.METRICS,
    *grid_metrics.FLOW,
    *grid_metrics.PHASES,
    *overload.METRICS,
    *metrics_of(),
    *feature_settings.METRICS,
    *riding_inverter.METRICS,
    *grid_metrics.AFTER_LOSS,
    *load_requests.METRICS,
    *fluctuation.METRICS,
    *grid_metrics.END,
)
_ROWS = "".join(f"| {metric.name} | {metric.meaning} |\n" for metric in _METRICS)
__doc__ = f"{__doc__}\n| metric | meaning |\n|---|---|\n{_ROWS}"
METRICS: dict[str, Metric] = {metric.name: metric for metric in _METRICS}
"""Every metric of an episode by its name."""


def metrics_in(table: str) -> tuple[Metric, ...]:
    """The metrics that a command's table shows, in order."""
    return tuple(metric for metric in _METRICS if table in metric.tables)
