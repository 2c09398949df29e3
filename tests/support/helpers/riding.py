"""Scenarios whose devices leave the grid and return."""

from typing import Any

import numpy as np

from dcgrid_env import Scenario, action_layout, make_scenario


def riding(name: str = "ieee33-weak", **changes: Any) -> Scenario:
    """A preset whose sites have the curve ``itic`` and whose inverters have that of IEEE 1547, in the sags of 2024."""
    given = {
        "horizon": 150,
        "datacenters.ride_through": {"curve": "itic", "by_hand_s": 20.0, "battery_s": 30.0, "recharge_share": 0.2},
        "inverters.ride_through": {"curve": "ieee1547-cat2", "return_delay_s": 5.0, "walk_in_s": 5.0},
        "sags": "virginia-2024",
    }
    return make_scenario(name, **given).replace(**changes)


def at_top_clock(scenario: Scenario, return_: float = 1.0) -> np.ndarray:
    """The joint action of top clocks, no reactive power and a channel ``return`` at a value, (n_action,)."""
    values = {"clock": 1.0, "return": return_}
    return np.array([values.get(channel, 0.0) for _, channel in action_layout(scenario).names])


def ride_through_34(**changes: Any) -> Scenario:
    """The three-phase 34-bus feeder with sites that leave and return as their agents say, in the sags of 2024."""
    rule = {"curve": "itic", "release": "agent", "by_hand_s": 60.0, "stagger_s": 20.0, "battery_s": 300.0}
    given = {
        "name": "ride-through",
        "horizon": 300,
        "datacenters.ride_through": rule,
        "inverters.ride_through": {"curve": "ieee1547-cat2"},
        "sags": "virginia-2024",
    }
    return make_scenario("ieee34-3ph", **given).replace(**changes)
