"""A fixed profile of power smoothing with parameters of its own in each lane, which a search of an episode is over."""

from __future__ import annotations

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.baselines.controller import Local
from dcgrid_env.baselines.laws.fixed_smoothing import FixedSmoothing, ramp_action, smoothing_of
from dcgrid_env.baselines.tuning.tuned import tuned_parameters


class LaneSmoothing(FixedSmoothing):
    """A fixed profile with parameters of its own in each lane.

    Parameters
    ----------
    x
        (lane, 5 + 3 n_datacenters): k_p in MW/p.u.; log10 of alpha in 1/s; log10 of k_q of sites and of all others in
        Mvar/p.u. s; the voltage that the droop holds, p.u.; of each site the actions that set floor, ramp up and ramp
        down; see :func:`smoothing_start`, and ``smoothing_bounds``.
    """

    def __init__(self, x: np.ndarray):
        super().__init__()
        self._x = x

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes, as many as there are rows of parameters."""
        super().reset(env_info)
        x, sites = self._x, env_info.n_datacenters
        gains = 10.0 ** np.repeat(x[:, 2:4], (sites, env_info.n_agents - sites), axis=1)
        self.k_p_mw_per_pu, self.k_q_mvar_per_pu_s = x[:, :1], gains  # pyright: ignore[reportAttributeAccessIssue]
        self.alpha_per_s = 10.0 ** x[:, 1:2]  # pyright: ignore[reportAttributeAccessIssue]
        own = x[:, 5:].reshape(-1, 3, sites)
        self._settings_at = [(at, own[:, i]) for i, (at, _) in enumerate(self._settings_at)]

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """Hold another voltage than 1 p.u., see :class:`LocalController`."""
        return super().control(local._replace(v_pu=local.v_pu - self._x[:, 4:5] + 1.0))


def smoothing_bounds(scenario: Scenario) -> np.ndarray:
    """Lowest and highest of each parameter of :class:`LaneSmoothing`, (2, n)."""
    actions = [(-1.0, 1.0)] * (3 * scenario.n_datacenters)
    return np.array([(0.0, 20.0), (-3.0, 0.3), (-2.7, 2.5), (-2.7, 2.5), (0.95, 1.05), *actions]).T


def smoothing_start(scenario: Scenario) -> np.ndarray:
    """The tuned profile as parameters of :class:`LaneSmoothing`, (n,)."""
    tuned, settings = tuned_parameters("smoothing", scenario).parameters, smoothing_of(scenario)
    alpha, k_q = (np.log10(max(tuned[name], 1e-3)) for name in ("alpha_per_s", "k_q_mvar_per_pu_s"))
    floor = 2.0 * min(tuned["floor_share"] / (settings.floor_share or 1.0), 1.0) - 1.0
    ways = ("ramp_up_w_per_s", "ramp_down_w_per_s")
    ramps = [ramp_action(tuned[way] / getattr(settings, way), settings.slowest_share) for way in ways]
    return np.array([tuned["k_p_mw_per_pu"], alpha, k_q, k_q, 1.0, *np.repeat([floor, *ramps], scenario.n_datacenters)])
