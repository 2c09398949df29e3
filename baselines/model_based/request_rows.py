"""Rows for a utility's requests in the linear program of an episode (``scenario.costs.load_requests``).

    over      r   distance of the sites' total draw from the request, kW, of each step
    with      sum_i s_i (base_i + d_i) - r <= upper          s: 1 for a site that is connected to the grid, else 0
              lower - sum_i s_i (base_i + d_i) <= r

The price of r is that of the cost, so no step pays for more than its distance.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from dcgrid_env import Forecast, Scenario

Part = tuple[dict[str, Any], np.ndarray]  # parts of rows by their unknowns, and what each row is, or is at most


class RequestRows:
    """The requests of a scenario in the program of an episode; nothing at all where it charges none.

    Parameters
    ----------
    scenario, episode
        The scenario, with its data centres before all other agents, and its episode.
    base_kw
        Draw of each site that no clock changes, kW, (T, n_dc).
    """

    def __init__(self, scenario: Scenario, episode: Forecast, base_kw: np.ndarray) -> None:
        self.steps, self.n = base_kw.shape
        self.weight = scenario.cost.weights.grid_request
        self.sizes = {"r": self.steps if self.weight else 0}
        """Number of unknowns of each name."""
        self.rated_kw = float(scenario.site_rated_kw.sum()) or 1.0
        self.request_kw = None if episode.request is None else self.rated_kw * episode.request
        self.connected = episode.available[:, : self.n]
        self.base_kw = (self.connected * base_kw).sum(axis=1)

    def prices(self) -> dict[str, float]:
        """Return what each unknown costs, as shares of J times T."""
        return {"r": self.weight / self.rated_kw}

    def limits(self, in_d: Any) -> list[Part]:
        """Return the rows of both ends of the requests; ``in_d`` picks the work served among d."""
        if not self.sizes["r"] or self.request_kw is None:
            return []
        of_step = sparse.kron(sparse.identity(self.steps), np.ones((1, self.n)), format="csr")
        drawn = of_step @ sparse.diags(self.connected.ravel(), format="csr") @ in_d
        one = sparse.identity(self.steps, format="csr")
        lower_kw, upper_kw = self.request_kw.T
        return [({"d": drawn, "r": -one}, upper_kw - self.base_kw), ({"d": -drawn, "r": -one}, self.base_kw - lower_kw)]
