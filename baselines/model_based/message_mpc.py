"""Model predictive control by agents that exchange their measurements, without sensors at other buses.

Each second every agent sends its voltage, powers, backlog and coming work to all others, one round of messages. Every
agent then computes the same estimate of all voltages and solves the same program as ``mpc``. U are the voltages under
the mean draw p' of all agents and without their reactive power,

    U_k = V_k - sum_a (X_ak q_a - R_ak (p_a - p'_a))

It depends on the other loads alone. The agents know it at their own buses, and estimate it elsewhere by linear
regression over moments of the training split (``operating_points``), which the feeder's model solves exactly:

    U^_k = mean U_k + sum_ij (U_i - mean U_i) (C + s^2 I)^-1_ij C_jk           i, j: agents

with C the covariance over the moments and s^2 the variance of the measurement noise and of the model's error (S. M.
Kay, "Fundamentals of statistical signal processing: estimation theory", 1993, chapter 12). With the agents' part
added again it is V^_k, from which ``mpc`` predicts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from dcgrid_env import Feeder, Scenario
from dcgrid_env.baselines.controller import Local
from dcgrid_env.baselines.model_aided.commissioning import site_of
from dcgrid_env.baselines.model_aided.knowledge import Site
from dcgrid_env.baselines.model_aided.moment_flow import MomentFlow
from dcgrid_env.baselines.model_based.linear_model import slopes
from dcgrid_env.baselines.model_based.mpc import Mpc

_MODEL_ERROR_PU = 1e-4  # standard deviation


class _Regression(NamedTuple):
    """Estimate of all voltages from those of the agents, for m placements, n agents and k buses."""

    mean_kw: np.ndarray
    """Mean draw, (m, n)."""
    by_p: np.ndarray
    """Rise of each voltage by each agent's draw (negative), p.u. per kW, (m, n, k)."""
    by_q: np.ndarray
    """Rise of each voltage by each agent's injection, p.u. per kvar, (m, n, k)."""
    observed_share: np.ndarray
    """Share of each voltage in what an agent measures, (m, n, k)."""
    mean_pu: np.ndarray
    """Mean U of each bus, (m, k)."""
    gain: np.ndarray
    """Weight of the agents' deviations from their mean U, (m, n, k)."""


@dataclass
class MessageMpc(Mpc):
    """Model predictive control with the measurements of the agents alone.

    Its information is the feeder's model, places and ratings of all agents, statistics of the other loads, and each
    second the local observations of all agents. It is more than that of ``model-aided`` and less than that of ``mpc``.
    Parameters are those of :class:`Mpc`.
    """

    horizon: int = 1

    name: ClassVar[str] = "mpc-messages"
    observe: ClassVar[str] = "local"

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes; ValueError for a scenario that ``Mpc`` or the model-aided law refuses."""
        super().reset(env_info)
        self._site = site_of(self.scenario)
        self._regression = None if self._fixed_buses is None else _regression(self._site, self._fixed_buses)

    def place(self, buses: np.ndarray) -> None:
        """See :class:`NeedsPlacement`."""
        super().place(buses)
        if self._fixed_buses is None:
            self._regression = _regression(self._site, np.asarray(buses)[:, self._equipment.is_other])

    def _measured(self, local: Local, then: np.ndarray) -> np.ndarray:
        self._placed_slopes(len(local.v_pu))  # which requires a placement
        known = self._regression
        assert known is not None
        agents = _product(then[0] - known.mean_kw, known.by_p) + _product(then[1], known.by_q)
        surprise = local.v_pu - _product(known.mean_pu + agents, known.observed_share.swapaxes(1, 2))
        return known.mean_pu + _product(surprise, known.gain) + agents


def _regression(site: Site, buses: np.ndarray) -> _Regression:
    """Fit the estimate for agents at positions ``buses`` of ``bus_ids``, (row, n_agent); one where all are the same."""
    placements, rows = np.unique(buses, axis=0, return_inverse=True)
    fitted = [_fitted(site, placement) for placement in placements]
    joined = _Regression(*(np.stack(field) for field in zip(*fitted, strict=True)))
    return joined if len(placements) == 1 else _Regression(*(field[rows.ravel()] for field in joined))


def _fitted(site: Site, placement: np.ndarray) -> _Regression:
    """Fit the estimate for one placement, (n_agent,); fields have no leading dimension."""
    s, draw = site.scenario, site.points.p_agent_kw
    flow = MomentFlow(site, placement)
    v = flow.voltages(np.zeros_like(draw))
    (by_p,), (by_q,) = slopes(s, placement[None])
    if isinstance(s.feeder, Feeder):
        by_p, by_q = by_p / v.mean(axis=0), by_q / v.mean(axis=0)
    mean_kw = draw.mean(axis=0)
    u = v - (draw - mean_kw) @ by_p
    mean = u.mean(axis=0)
    apart = u - mean
    of_agents = apart @ flow.observed_share.T
    noise = (s.sensing.noise_pu**2 + _MODEL_ERROR_PU**2) * np.eye(len(mean_kw))
    gain = np.linalg.solve(of_agents.T @ of_agents / len(u) + noise, of_agents.T @ apart / len(u))
    return _Regression(mean_kw, by_p, by_q, flow.observed_share, mean, gain)


def _product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Product of vectors (row, a) with the matrices of their rows or of all, (row or 1, a, b)."""
    return np.matmul(left[:, None], right)[:, 0]
