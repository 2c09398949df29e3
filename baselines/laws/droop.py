"""The droop law of arXiv 2507.06416 (Chen and Zhang), on both axes, with signs for loads as consumption.

    P_{t+1} = clip(p_ref_{t+1} + k_p (V_t - 1) + alpha S_t, P_min, p_rated)      the clock whose ceiling is P
    Q_{t+1} = clip(Q_t - k_q (V_t - 1) dt, limits now)                           Q_t as dispatched, so no wind-up

The paper's equation (5) for P and (7) for Q read as an injection law, its text as consumption. S is the backlog:
``cumulative`` is all work that waits; ``one_step``, equation (6) as printed, is p_ref - P of the last step, which may
be negative and forgets.
The paper says in words that alpha may be larger where the backlog is large, without a formula. The form here is ours,
alpha_t = alpha (1 + g max(S, 0) / p_rated): at 1/g seconds of work at the rating alpha has doubled; g = 0 disables it.
The ceiling is that of the linear clock law, whichever law the scenario has: under another one P is not quite met.
Where the scenario hides p_ref (``sensing.preview``) the rating replaces it: below 1 p.u. the site is capped.
Inverters run the second law alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.baselines.controller import Local, LocalController
from dcgrid_env.baselines.parameter_checks import require_non_negative
from dcgrid_env.devices import site_work

Memory = Literal["cumulative", "one_step"]


@dataclass
class Droop(LocalController):
    """The paper's droop.

    Parameters
    ----------
    k_p_mw_per_pu
        Active gain of the data centres, MW per p.u. (1, 10 and 20 in the paper's Table I).
    k_q_mvar_per_pu_s
        Reactive gain of all agents, Mvar per p.u. and second.
    alpha_per_s
        Share of the backlog added to the power asked for, per second.
    memory
        "cumulative" or "one_step".
    datacenters
        Whether the data centres take part; if not they run at the top clock without reactive power.
    alpha_growth_per_s
        Growth of alpha with the backlog, for each second of it at the rated power (g above).
    """

    k_p_mw_per_pu: float = 1.0
    k_q_mvar_per_pu_s: float = 0.5
    alpha_per_s: float = 0.3
    memory: Memory = "cumulative"
    datacenters: bool = True
    alpha_growth_per_s: float = 0.0

    def __post_init__(self) -> None:
        require_non_negative(
            "droop",
            k_p_mw_per_pu=self.k_p_mw_per_pu,
            k_q_mvar_per_pu_s=self.k_q_mvar_per_pu_s,
            alpha_per_s=self.alpha_per_s,
            alpha_growth_per_s=self.alpha_growth_per_s,
        )
        if self.memory not in get_args(Memory):
            raise ValueError(f"droop: memory is {self.memory!r}; choose one of {', '.join(get_args(Memory))}")

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes; ValueError where the one-step memory needs a p_ref that the scenario hides."""
        if (
            self.memory == "one_step"
            and self.datacenters
            and env_info.datacenters.count
            and not env_info.sensing.preview
        ):
            raise ValueError("droop with the one-step memory needs p_ref; make the scenario with sensing.preview")
        super().reset(env_info)
        self._requested_kw: np.ndarray | None = None

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`LocalController`."""
        s, dc = self.scenario, self.scenario.datacenters.parameters
        n_dc = s.datacenters.count
        q = local.q_kvar - 1000.0 * self.k_q_mvar_per_pu_s * (local.v_pu - 1.0) * s.dt_s
        q = np.clip(q, -self._q_scale, self._q_scale)
        if not self.datacenters:
            q[..., :n_dc] = 0.0
            return np.full_like(local.p_ref_next_kw, s.datacenters.f_max_mhz), q
        waiting = local.backlog_kws if self.memory == "cumulative" else self._last_shortfall(local)
        p = (
            (local.p_ref_next_kw if s.sensing.preview else dc.p_rated_kw)
            + 1000.0 * self.k_p_mw_per_pu * (local.v_pu[..., :n_dc] - 1.0)
            + self._alpha_per_s(waiting) * waiting
        )
        # The limits of the clock cut P to P_min and p_rated.
        return site_work.clock_for(dc.p_idle_kw, dc.p_dynamic_kw, dc.f_min_mhz, dc.f_max_mhz, p), q

    def _alpha_per_s(self, waiting_kws: np.ndarray) -> np.ndarray | float:
        """Share of the backlog added to the power asked for, per second, now."""
        if not self.alpha_growth_per_s:
            return self.alpha_per_s
        waiting_s = np.maximum(waiting_kws, 0.0) / self.scenario.datacenters.parameters.p_rated_kw
        return self.alpha_per_s * (1.0 + self.alpha_growth_per_s * waiting_s)

    def _last_shortfall(self, local: Local) -> np.ndarray:
        """(p_ref - P) dt of the last step, kW s; none before the first."""
        requested_kw, self._requested_kw = self._requested_kw, local.p_ref_next_kw
        if requested_kw is None:
            return np.zeros_like(local.p_ref_next_kw)
        return (requested_kw - local.p_kw[..., : self.scenario.datacenters.count]) * self.scenario.dt_s
