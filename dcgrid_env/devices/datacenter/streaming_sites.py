"""Streaming figures of data centres, equal to those of ``DataCenters.metrics`` for a whole episode.

If the trace consists of requests, their times depend on the queues of the whole episode. The few columns needed for
them are kept, about 40 bytes per site and step.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from dcgrid_env.core.metric import Combined
from dcgrid_env.devices.datacenter.clock_law import Dvfs
from dcgrid_env.devices.datacenter.feature_settings import METRICS as OF_FEATURES
from dcgrid_env.devices.datacenter.site_metrics import METRICS, delay_figures, mean_clock_pct, request_figures
from dcgrid_env.devices.datacenter.streaming_waiting import WaitingTimes
from dcgrid_env.devices.device import DeviceState, Requests
from dcgrid_env.devices.ratings import DataCenterParams

_OF_REQUESTS = (
    "class_arrived_kw", "class_served_kw", "f_mhz", "batch_wait_s", "arrived_kw", "sent_kw", "received_kw",
)  # fmt: skip
"""Fields that times of requests hang on, where there are such."""


class StreamingSites:
    """Accumulates the figures of a group of data centres.

    Parameters
    ----------
    params, clock_law, features
        Ratings of the sites, how their clock acts, and their features.
    latency_s
        That of a move between sites, s.
    dt_s, requests
        See ``Device.metrics``.
    """

    def __init__(
        self,
        params: DataCenterParams,
        clock_law: Dvfs,
        features: tuple[Any, ...],
        latency_s: float,
        dt_s: float,
        requests: Requests,
    ):
        self.params, self.clock_law, self.features = params, clock_law, features
        self.latency_s, self.dt_s, self.requests = latency_s, dt_s, requests
        self._waiting, self._combined = WaitingTimes(dt_s), Combined((*METRICS, *OF_FEATURES))
        self._feature_metrics = [getattr(feature, "streaming", lambda *_: None)(params, dt_s) for feature in features]
        self._kept: dict[str, list[np.ndarray]] = {}

    def add(self, history: DeviceState, steps: int) -> None:
        """Take a part, see ``core.metric.Streaming``."""
        arrived, served = (w[1:].reshape(steps, -1) for w in (history.class_arrived_kw, history.class_served_kw))
        self._waiting.add(arrived, served)
        figures = {"clock_mean_pct": mean_clock_pct(self.params, history)}
        for feature, feature_metrics, state in zip(
            self.features, self._feature_metrics, getattr(history, "features", ()), strict=True
        ):
            if feature_metrics is None:
                figures |= feature.metrics(self.params, history, state, self.dt_s)
            else:
                feature_metrics.add(history, state)
        shares = {
            m.name: getattr(history, m.share_of)[1:].sum() for m in OF_FEATURES if m.share_of and m.name in figures
        }
        self._combined.add(figures, steps, shares)
        if self.requests:
            for name in _OF_REQUESTS:
                if (values := getattr(history, name, None)) is not None:
                    self._kept.setdefault(name, []).append(np.array(values[1:] if self._kept.get(name) else values))

    def figures(self) -> dict[str, float]:
        """Those of all parts so far."""
        figures = delay_figures(self._waiting.delays()) | self._combined.figures()
        if self.requests:
            whole = SimpleNamespace(**{name: np.concatenate(parts) for name, parts in self._kept.items()})
            figures |= request_figures(self.params, self.clock_law, whole, self.dt_s, self.requests, self.latency_s)
        for feature_metrics in self._feature_metrics:
            if feature_metrics is not None:
                figures |= feature_metrics.figures()
        return figures
