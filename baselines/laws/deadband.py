"""Proportional reactive droop with a deadband and a ramp limit.

    e   = V - 1 less the deadband: 0 within +-d, V - 1 -+ d outside
    q*  = clip(-k e, -1, 1) q_limit                                q_limit: the reactive limit at zero active power
    q_{t+1} = q_t + clip(q* - q_t, -ramp dt, ramp dt)              q_t as dispatched

The textbook form of local volt-var control (among those compared by Turitsyn, Sulc, Backhaus and Chertkov, "Options for
control of reactive power by distributed photovoltaic generators", Proc. IEEE 99(6), 2011), in shares of each agent's
own limit so that one setting fits devices of any size. Unlike the integrating droop it leaves a deviation, and it gives
its reactive power back when the voltage has returned. The data centres run at their top clock.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dcgrid_env.baselines.controller import Local, LocalController
from dcgrid_env.baselines.parameter_checks import require_non_negative


@dataclass
class DeadbandDroop(LocalController):
    """Droop outside a deadband.

    Parameters
    ----------
    k_share_per_pu
        Gain: share of the reactive limit for each p.u. beyond the deadband; at 20 the limit is reached
        0.05 p.u. beyond.
    deadband_pu
        Half the width of the deadband, p.u.
    ramp_share_per_s
        Largest change of the setpoint, share of the limit per second.
    """

    k_share_per_pu: float = 20.0
    deadband_pu: float = 0.01
    ramp_share_per_s: float = 0.1

    def __post_init__(self) -> None:
        require_non_negative(
            "deadband",
            k_share_per_pu=self.k_share_per_pu,
            deadband_pu=self.deadband_pu,
            ramp_share_per_s=self.ramp_share_per_s,
        )

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`LocalController`."""
        target = -np.clip(self.k_share_per_pu * beyond(local.v_pu - 1.0, self.deadband_pu), -1.0, 1.0) * self._q_scale
        reach = self.ramp_share_per_s * self.scenario.dt_s * self._q_scale
        q = local.q_kvar + np.clip(target - local.q_kvar, -reach, reach)
        return np.full_like(local.p_ref_next_kw, self.scenario.datacenters.f_max_mhz), q


def beyond(deviation: np.ndarray, deadband: float) -> np.ndarray:
    """What a deviation has beyond a deadband of +-``deadband``, 0 within."""
    return deviation - np.clip(deviation, -deadband, deadband)
