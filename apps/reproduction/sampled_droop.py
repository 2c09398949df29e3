"""The paper's droop with a control interval longer than the step of the simulation.

The grid and the load move at each step; voltage and backlog are measured, and the reactive setpoint is moved, once in
the interval, and hold in between. The load's own p_ref passes, so that what is compared is how often the control acts
and not how old its knowledge of the load is. With T the interval:

    Q <- clip(Q - k_q (V - 1) T, limits now)        P_t = clip(p_ref_t + k_p (V - 1) + alpha S, P_min, p_rated)

k_q and alpha are gains per second and k_p per unit of voltage, so none of them is scaled.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.baselines import Droop, Local


@dataclass
class SampledDroop(Droop):
    """Droop that acts once in ``hold_steps`` steps, with the cumulative backlog.

    Parameters
    ----------
    hold_steps
        Steps in an interval, at least 1; with 1 it is :class:`Droop`.
    """

    hold_steps: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.hold_steps < 1 or self.memory != "cumulative":
            raise ValueError(
                f"sampled droop: hold_steps is {self.hold_steps} and memory {self.memory!r}; give at least 1 step and "
                "the cumulative memory"
            )

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes; the law integrates over the interval, not over the step."""
        super().reset(env_info.replace(dt_s=env_info.dt_s * self.hold_steps))
        self._age = 0

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`LocalController`."""
        if self._age % self.hold_steps == 0:
            self._measured = local
        self._age += 1
        measured = self._measured
        return super().control(
            local._replace(v_pu=measured.v_pu, q_kvar=measured.q_kvar, backlog_kws=measured.backlog_kws)
        )
