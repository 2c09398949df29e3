"""Which scenarios a controller by its name can drive, for tests over all controllers."""

from collections.abc import Callable

from dcgrid_env import Scenario
from dcgrid_env.baselines.laws.site_return import has_return_channel


def has_storage(scenario: Scenario) -> bool:
    """Whether there are storages."""
    return any(device.kind == "storage" and device.count for device in scenario.devices)


def is_known_to_models(scenario: Scenario) -> bool:
    """Whether controllers with a model know all of its devices: no storages, and none that may leave the grid."""
    stays = all(getattr(device, "ride_through", None) is None for device in scenario.devices)
    return stays and not has_storage(scenario)


NEEDS: dict[str, Callable[[Scenario], bool]] = {
    "peak-shaving": has_storage,
    "return-by-hand": has_return_channel,
    "staggered-return": has_return_channel,
    "mpc": is_known_to_models,
    "mpc-one-step": is_known_to_models,
    "feedback": is_known_to_models,
}
NEEDING_A_DEVICE = ("peak-shaving", "return-by-hand", "staggered-return")
"""Controllers that refuse a scenario of data centres and inverters alone."""


def drives(name: str, scenario: Scenario) -> bool:
    """Whether a controller, tuned or not, can drive a scenario."""
    return NEEDS.get(name.removesuffix("-tuned"), lambda _: True)(scenario)
