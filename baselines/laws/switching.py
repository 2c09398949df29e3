"""The switching-reference law for AI-training loads: two voltage references, one for each level of the load.

    A_t       = gain max |V_s - V_{s-1}| over the last window             half the step that the load's edges make
    V_ref,t   = 1 + A_t where V_t > 1, else 1 - A_t                       switched on the local voltage alone
    q_{t+1}   = q_t - k_q g(V_t - V_ref,t) dt                             g: the deviation beyond a deadband

Yan, Joswig-Jones, Zhang, Chen and Cui, "Switching-Reference Voltage Control for Distribution Systems with AI-Training
Data Centers", arXiv 2603.15588, algorithm 1, in the form of its public code (github.com/yan-mingyuan/switchref, commit
3d74db9: ``AdaRefVBiasAmpMaxDV`` with amp_gain 0.5). A training load jumps between computing and exchanging gradients.
With a fixed reference the reactive power follows each edge. Here each level has its own target, the two are around
1 p.u., and the worst deviation after an edge is half the jump. With a steady load it is the plain droop.

Differences from that code: the gain is in Mvar per p.u. and s as in ``Droop`` and the same for all agents. The bias,
which slowly moves the centre of both references, is left out, as the law integrates. The deadband is 0 by default
instead of 0.02 p.u., so the law differs from ``Droop(k_p_mw_per_pu=0)`` in its reference alone. The window should
contain a cycle of the load. An edge that takes longer than a step of dt is seen as its steepest step. Data centres give
reactive power too and run at their top clock.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.baselines.controller import Local, LocalController
from dcgrid_env.baselines.laws.deadband import beyond
from dcgrid_env.baselines.parameter_checks import require_non_negative


@dataclass
class SwitchingReference(LocalController):
    """Droop towards a reference that follows the load's two levels.

    Parameters
    ----------
    k_q_mvar_per_pu_s
        Reactive gain of all agents, Mvar per p.u. and second.
    window_s
        Time over which the largest voltage step is sought, s: a cycle of the load.
    amplitude_gain
        The references' distance from 1 p.u. as a share of that step.
    deadband_pu
        Half the width of the deadband around the reference, p.u.
    """

    k_q_mvar_per_pu_s: float = 0.5
    window_s: float = 10.0
    amplitude_gain: float = 0.5
    deadband_pu: float = 0.0

    def __post_init__(self) -> None:
        require_non_negative(
            "switching",
            k_q_mvar_per_pu_s=self.k_q_mvar_per_pu_s,
            window_s=self.window_s,
            amplitude_gain=self.amplitude_gain,
            deadband_pu=self.deadband_pu,
        )

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes: nothing is known of the load's steps."""
        super().reset(env_info)
        self._length = max(1, round(self.window_s / env_info.dt_s))
        self._v_last_pu: np.ndarray | None = None

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`LocalController`."""
        s = self.scenario
        if self._v_last_pu is None:
            self._steps_pu = np.zeros((self._length, *local.v_pu.shape))
            self._count = 0
        else:
            self._steps_pu[self._count % self._length] = np.abs(local.v_pu - self._v_last_pu)
            self._count += 1
        self._v_last_pu = local.v_pu
        amplitude = self.amplitude_gain * self._steps_pu.max(axis=0)
        reference = 1.0 + np.where(local.v_pu > 1.0, amplitude, -amplitude)
        error = beyond(local.v_pu - reference, self.deadband_pu)
        q = local.q_kvar - 1000.0 * self.k_q_mvar_per_pu_s * error * s.dt_s
        return np.full_like(local.p_ref_next_kw, s.datacenters.f_max_mhz), np.clip(q, -self._q_scale, self._q_scale)
