"""Route to the strongest bus: sites whose voltage will be low pass work to sites whose voltage will be high.

    V'_i = V_i - h R_ii (p_ref_i - p_i)                  voltage to come if every site kept its own work, h from 0 to 1
    r_i  = clip(g (V'_i - mean V'), -1, 1)               below 0 given away, above 0 taken; the mean is over the sites

R_ii is the drop of a site's own voltage for each MW that it draws, so V' counts on what comes for it alone and not on
what others will draw. With a large gain the strongest bus takes all that it may. If the scenario hides p_ref, the
measured voltages are used. Clocks and reactive power follow the paper's droop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dcgrid_env import Scenario, action_layout
from dcgrid_env.baselines.laws.droop import Droop
from dcgrid_env.baselines.parameter_checks import require_non_negative


@dataclass
class RouteToStrongest(Droop):
    """Routing of work towards the strongest bus, in addition to the droop.

    Parameters
    ----------
    route_gain_per_pu
        Share given or taken for each p.u. that a voltage lies below or above the mean (g above).
    look_ahead
        Share of the coming change of draw that is counted on (h above).
    """

    route_gain_per_pu: float = 50.0
    look_ahead: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        require_non_negative("route-to-strongest", route_gain_per_pu=self.route_gain_per_pu, look_ahead=self.look_ahead)

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes; ValueError for a scenario whose work cannot be routed."""
        super().reset(env_info)
        if not has_routing(env_info):
            raise ValueError(
                f"route-to-strongest: the sites of scenario {env_info.name!r} have no channel 'route'; give it "
                "datacenters={'routing': {}}, or use the law 'droop'"
            )
        self._route_at = np.flatnonzero(action_layout(self.scenario).is_channel("route"))

    def _act(self, joint: np.ndarray) -> np.ndarray:
        actions = super()._act(joint)
        local, sites = self._local(joint), slice(self.scenario.datacenters.count)
        strength = local.v_pu[..., sites]
        if self.scenario.sensing.preview:
            more_mw = (local.p_ref_next_kw - local.p_kw[..., sites]) / 1000.0
            strength = strength - self.look_ahead * local.r_pu_per_mw[..., sites] * more_mw
        apart = strength - strength.mean(axis=-1, keepdims=True)
        actions[..., self._route_at] = np.clip(self.route_gain_per_pu * apart, -1.0, 1.0)
        return actions


def has_routing(scenario: Scenario) -> bool:
    """Whether work can be moved between the sites of a scenario."""
    sites = scenario.datacenters
    return sites.count > 0 and sites.routing is not None
