"""Which scenarios a controller by its name can drive, for tests over all controllers."""

from collections.abc import Callable

from dcgrid_env import Scenario
from dcgrid_env.baselines.laws.route_to_strongest import has_routing
from dcgrid_env.baselines.laws.site_return import has_return_channel


def has_storage(scenario: Scenario) -> bool:
    """Whether there are storages."""
    return any(device.kind == "storage" and device.count for device in scenario.devices)


def stays_connected(scenario: Scenario) -> bool:
    """Whether no device may leave the grid, which no linear model has."""
    return all(getattr(device, "ride_through", None) is None for device in scenario.devices)


NEEDS: dict[str, Callable[[Scenario], bool]] = {
    "peak-shaving": has_storage,
    "return-by-hand": has_return_channel,
    "staggered-return": has_return_channel,
    "route-to-strongest": has_routing,
    "mpc": stays_connected,
    "mpc-one-step": stays_connected,
    "feedback": stays_connected,
}
NEEDING_A_DEVICE = ("peak-shaving", "return-by-hand", "staggered-return", "route-to-strongest")
"""Controllers that refuse a scenario of data centres and inverters alone."""


def drives(name: str, scenario: Scenario) -> bool:
    """Whether a controller, tuned or not, can drive a scenario."""
    return NEEDS.get(name.removesuffix("-tuned"), lambda _: True)(scenario)
