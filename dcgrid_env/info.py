"""What stands in ``info``: flat, finite, the same keys at every step."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from dcgrid_env.simulation import Transition


def info_arrays(transition: Transition) -> dict[str, np.ndarray]:
    """Figures of a step, each (lane,).

    ``cost_*`` are the weighted terms as charged, their sum is minus the team's reward; ``cost`` is the violation alone,
    for constrained learning. Voltages are over buses other than the substation.
    """
    state, costs = transition.state, transition.costs
    v = state.v_pu[:, 1:]
    return {
        "cost": costs.violation,
        "cost_voltage": costs.voltage,
        "cost_violation": costs.violation,
        "cost_backlog": costs.backlog,
        "cost_effort": costs.effort,
        "cost_clock": costs.clock,
        "cost_step": costs.step,
        "cost_loss": costs.loss,
        "cost_leftover": costs.leftover,
        "power_flow_converged": transition.converged,
        "voltage_min_pu": np.minimum.reduce(v, -1),
        "voltage_max_pu": np.maximum.reduce(v, -1),
        "backlog_kws": np.add.reduce(state.backlog_kws, -1),
        "loss_kw": transition.loss_kw,
    }
