"""The volt-var curve of IEEE 1547-2018 with the default settings of category B, at every agent.

    q* = s_rated curve(V)                            (0.92, 44 %), (0.98, 0), (1.02, 0), (1.08, -44 %), flat beyond
    q_{t+1} = q_t + (1 - exp(-dt / tau)) (q* - q_t)  tau = T / ln 10, so that 90 % of a step is done within T

The settings are those of IEEE Std 1547-2018, clause 5.3.3, table 8 (category B, default). V_ref is 1, V2 and V3 are
0.02 p.u. away from it, V1 and V4 0.08 p.u. Q1 and Q4 are 44 % of the nameplate apparent power, injected and absorbed.
The open-loop response time is T = 5 s (allowed: 1 to 90 s), the time to 90 % of the final change. The text of the
standard was not available. The figures and the first-order response are those of EPRI's OpenDER
(github.com/epri-dev/OpenDER, category B). The autonomous adjustment of V_ref, off by default there, is left out. q_t is
the dispatched value, which avoids wind-up at a limit. A data centre follows the same curve, cut to its limit, and runs
at its top clock.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dcgrid_env.baselines.controller import Local, LocalController
from dcgrid_env.baselines.parameter_checks import require_finite, require_non_negative


@dataclass
class VoltVar(LocalController):
    """The standard's volt-var function.

    Parameters
    ----------
    v_pu
        V1..V4, p.u., ascending.
    q_share
        Q1..Q4, share of the rated apparent power, injection positive, not rising.
    response_s
        Open-loop response time, s; 0 acts at once.
    """

    v_pu: tuple[float, float, float, float] = (0.92, 0.98, 1.02, 1.08)
    q_share: tuple[float, float, float, float] = (0.44, 0.0, 0.0, -0.44)
    response_s: float = 5.0

    def __post_init__(self) -> None:
        require_non_negative("volt-var", response_s=self.response_s)
        for name, values in (("v_pu", self.v_pu), ("q_share", self.q_share)):
            if len(values) != 4:
                raise ValueError(f"volt-var: {name} has {len(values)} points; give 4")
            require_finite("volt-var", **{f"{name}[{i}]": value for i, value in enumerate(values)})
        if np.any(np.diff(self.v_pu) < 0):
            raise ValueError(f"volt-var: v_pu is {self.v_pu!r}; give voltages in ascending order")
        if np.any(np.diff(self.q_share) > 0):
            raise ValueError(f"volt-var: q_share is {self.q_share!r}; give shares that do not rise with the voltage")

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`LocalController`."""
        s = self.scenario
        target = self._rated_kva * np.interp(local.v_pu, self.v_pu, self.q_share)
        target = np.clip(target, -self._q_scale, self._q_scale)
        remains = 10.0 ** (-s.dt_s / self.response_s) if self.response_s else 0.0  # exp(-dt / tau)
        return np.full_like(local.p_ref_next_kw, s.datacenters.f_max_mhz), target + remains * (local.q_kvar - target)
