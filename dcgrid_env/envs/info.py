"""What stands in ``info``: flat, finite, the same keys at every step."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from dcgrid_env.scenario.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.engine.simulation import Transition

InfoLevel = Literal["none", "costs", "full"]
"""How much stands in ``info``: nothing, the cost terms and J, or all figures and the agents' buses."""

INFO_LEVELS: tuple[InfoLevel, ...] = get_args(InfoLevel)


@cache
def _keys(kind: Any) -> tuple[str, ...]:
    """Keys of the cost terms."""
    return tuple(f"cost_{name}" for name in kind._fields)


def info_arrays(scenario: Scenario, transition: Transition, level: InfoLevel = "full") -> dict[str, np.ndarray]:
    """Figures of a step, each (lane,), float64; ``power_flow_converged`` is 1 or 0.

    ``cost_*`` are the weighted terms as charged, their sum is minus the team's reward; ``cost`` is the violation alone,
    for constrained learning. ``J`` is the cost so far as a share of the episode's: the sum of all terms since the reset
    over T, and so in an episode's last step its J. Voltages are over buses other than the substation.
    """
    if level == "none":
        return {}
    costs = transition.costs
    figures = {"cost": costs.violation, **dict(zip(_keys(type(costs)), costs, strict=True))}
    figures["J"] = transition.j_so_far
    if level == "costs":
        return figures
    state = transition.state
    v = state.v_pu[:, scenario.feeder.load_slice]
    figures["power_flow_converged"] = transition.converged.astype(np.float64)
    figures["voltage_min_pu"] = np.minimum.reduce(v, -1)
    figures["voltage_max_pu"] = np.maximum.reduce(v, -1)
    for device, its_state in zip(scenario.devices, state.devices, strict=True):
        if its_state:
            figures.update(device.totals(its_state))
    figures["loss_kw"] = transition.loss_kw
    return figures
