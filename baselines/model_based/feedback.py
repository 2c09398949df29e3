"""Online feedback optimisation: one projected primal-dual step a second on the measured voltages.

With e = V - 1 at every bus, S the model's slopes (``model``) and x = (work served, reactive injection) as dispatched:

    l   <- clip((1 - s) l   + s k e,            -w_v, w_v)        multiplier of mean|e|,  w_v its weight for a bus
    m_+ <- clip((1 - s) m_+ + s k (e - band),      0, w_o)        of the excess above the band; m_- of that below it
    x   <- project(x - g D (S' (l + m_+ - m_-) + grad f(x)))      f: the prices of waiting work and reactive effort

If the cost has a voltage profile with a band b, e in the first line is the distance from the target of each bus, and
max(|.| - s k b, 0) with the sign as before is clipped: the multiplier of mean max(|e| - b, 0).

These are projected primal-dual steps on a regularised Lagrangian in which the network's response is measured and not
computed (E. Dall'Anese and A. Simonetto, "Optimal power flow pursuit", IEEE Trans. Smart Grid 9(2), 2018; A. Hauswirth,
Z. He, S. Bolognani, G. Hug and F. Doerfler, "Optimization algorithms as robust feedback controllers", Annual Reviews in
Control 57, 2024). The voltage terms are penalties and not limits, so their multipliers are bounded by the weights. k =
w_v / width sets how close to its kink a term gives way, and 1 / k is the regularisation. With

    D_j = 1 / (k sum_i |S_ij| sum_n |S_in|)        so that k S'S <= D^-1        (after T. Pock and A. Chambolle,
                                                   "Diagonal preconditioning for first order primal-dual algorithms in
                                                   convex optimization", ICCV 2011)

no mode of the loop has a curvature above 1. The loop is stable on the model for g < 2 (2 - s) / s, the limit at which
z^2 - (2 - s - g s) z + 1 - s has a root of magnitude 1. With few voltages at their kinks there is more room.

A site's clock cannot drop work, so its variable is how far arriving work is deferred. It is the served work, moved by
the increase of arriving work in the coming step. The voltages are moved by the same. Waiting work has the price of a
step and of leftover work, so deferral ends when it no longer pays. x starts from the dispatched values, which avoids
wind-up.

The defaults were chosen on the validation split of toy6, ieee123 and ieee33-weak, the last also with R and X off by
20 %, noise of 0.002 p.u., a delay of two steps and no preview. With g beyond the limit toy6 oscillates: J = 0.70 with
g = 10, s = 1 and a width of 0.002, and 0.28 with the defaults.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dcgrid_env import Scenario, cost_prices, voltage_targets
from dcgrid_env.baselines.model_based.linear_model import Estimate, ModelController
from dcgrid_env.baselines.parameter_checks import require_non_negative
from dcgrid_env.devices import site_work


@dataclass
class FeedbackOptimisation(ModelController):
    """Projected primal-dual steps on measured voltages.

    Parameters
    ----------
    gain
        Primal step as a share of the diagonal one (g above).
    dual_step
        Dual step, 0 < s <= 1; at 1 the multipliers follow the last measurement alone.
    width_pu
        Deviation at which a term's multiplier reaches the weight of mean abs(V - 1), p.u.
    """

    gain: float = 10.0
    dual_step: float = 0.3
    width_pu: float = 0.0015

    name: ClassVar[str] = "feedback"

    def __post_init__(self) -> None:
        require_non_negative(self.name, gain=self.gain, width_pu=self.width_pu)
        if not 0.0 < self.dual_step <= 1.0:
            raise ValueError(f"{self.name}: dual_step is {self.dual_step!r}; give a number above 0 and up to 1")
        if self.width_pu == 0.0:
            raise ValueError(f"{self.name}: width_pu is 0; give a number > 0")

    def reset(self, env_info: Scenario) -> None:
        """See :class:`ModelController`."""
        super().reset(env_info)
        s, prices = self.scenario, cost_prices(self.scenario)
        self._weights = prices.voltage, prices.violation
        steepest = max(prices.voltage, 0.01 * prices.violation) or 1.0 / len(s.feeder.load_nodes)
        self._slope = steepest / self.width_pu
        self._backlog_price = (prices.backlog + prices.leftover) * s.dt_s  # of each kW held back
        self._effort_price = prices.effort
        self._size = np.concatenate((s.datacenters.parameters.p_dynamic_kw, self._q_scale))
        self._target_pu = voltage_targets(s)[s.feeder.load_slice] - 1.0
        self._multipliers: tuple[np.ndarray, ...] | None = None

    def plan(self, now: Estimate) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`ModelController`."""
        s, dc, local = self.scenario, self.scenario.datacenters.parameters, now.local
        n_dc = s.datacenters.count
        p_ref_kw = local.p_ref_next_kw if s.sensing.preview else now.p_ref_kw
        arrived_kw, arrives_kw = (site_work.arriving(dc.p_idle_kw, p) for p in (now.p_ref_kw, p_ref_kw))
        served_kw = local.p_kw[:, :n_dc] - site_work.idle_draw(dc.p_idle_kw, now.p_ref_kw)
        by_p = now.by_p[:, :n_dc]
        e = now.v_pu - 1.0 + np.matmul((p_ref_kw - now.p_ref_kw)[:, None], by_p)[:, 0]
        slopes = np.concatenate((by_p, now.by_q), axis=1)
        pull = np.matmul(slopes, self._dual(e)[..., None])[..., 0]
        step = self._step(slopes)

        d = served_kw + arrives_kw - arrived_kw - step[:, :n_dc] * (pull[:, :n_dc] - self._backlog_price)
        # Where all work is to be served the clock may as well be at its top.
        at_hand_kw = site_work.at_hand(local.backlog_kws, arrives_kw, s.dt_s)
        share = np.where(d >= at_hand_kw, 1.0, d / site_work.top_power(dc.p_dynamic_kw, arrives_kw))
        q = local.q_kvar - step[:, n_dc:] * pull[:, n_dc:]
        q = np.copysign(np.maximum(np.abs(q) - step[:, n_dc:] * self._effort_price, 0.0), q)
        return np.clip(share * s.datacenters.f_max_mhz, s.datacenters.f_min_mhz, s.datacenters.f_max_mhz), np.clip(
            q, -self._q_scale, self._q_scale
        )

    def _dual(self, e: np.ndarray) -> np.ndarray:
        """Move the multipliers on; what a rise of each bus's voltage costs by them, (row, n_load_node)."""
        voltage, violation = self._weights
        keep, by, band = 1.0 - self.dual_step, self.dual_step * self._slope, self.scenario.cost.band_pu
        apart, above, below = self._multipliers or (np.zeros_like(e),) * 3
        apart = keep * apart + by * (e - self._target_pu)
        charged = np.maximum(np.abs(apart) - by * self.scenario.cost.uncharged_pu, 0.0)
        apart = np.clip(np.copysign(charged, apart), -voltage, voltage)
        above = np.clip(keep * above + by * (e - band), 0.0, violation)
        below = np.clip(keep * below - by * (e + band), 0.0, violation)
        self._multipliers = (apart, above, below)
        return apart + above - below

    def _step(self, slopes: np.ndarray) -> np.ndarray:
        """g D, in kW and kvar for each unit of cost per kW and kvar, (row, n)."""
        reach = np.abs(slopes) * self._size[:, None]  # in shares of a device's range, so that they compare
        curvature = self._slope * np.matmul(reach, reach.sum(axis=1)[..., None])[..., 0]
        return self.gain * self._size**2 / np.maximum(curvature, 1e-12)
