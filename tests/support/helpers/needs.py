"""Which scenarios a controller by its name can drive, for tests over all controllers."""

from collections.abc import Callable

from dcgrid_env import Scenario
from dcgrid_env.baselines.laws.constant_set_points import agents_choose_set_points, has_set_points
from dcgrid_env.baselines.laws.fixed_smoothing import has_smoothing_channels
from dcgrid_env.baselines.laws.peak_shaving import has_storages
from dcgrid_env.baselines.laws.request_sharing import has_requests
from dcgrid_env.baselines.laws.route_to_strongest import has_routing
from dcgrid_env.baselines.laws.site_return import has_return_channel
from dcgrid_env.baselines.tuning.tunable import TUNABLE


def stays_connected(scenario: Scenario) -> bool:
    """Whether no device may leave the grid, which no linear model has."""
    return all(getattr(device, "ride_through", None) is None for device in scenario.devices)


def can_be_planned(scenario: Scenario) -> bool:
    """Whether no site leaves the grid or draws something else than what its work takes, which no linear model has."""
    sites = scenario.datacenters
    return stays_connected(scenario) and sites.smoothing is None and sites.cooling is None


def is_known_to_models(scenario: Scenario) -> bool:
    """Whether controllers with a model know all that is there; of storages hindsight alone knows."""
    return can_be_planned(scenario) and not has_storages(scenario)


def is_priced_by_models(scenario: Scenario) -> bool:
    """Whether controllers that minimise the cost know all its terms; of requests hindsight alone knows."""
    return is_known_to_models(scenario) and not scenario.cost.weights.grid_request


NEEDS: dict[str, Callable[[Scenario], bool]] = {
    "peak-shaving": has_storages,
    "return-by-hand": has_return_channel,
    "staggered-return": has_return_channel,
    "smoothing": has_smoothing_channels,
    "smoothing-light": has_smoothing_channels,
    "smoothing-strong": has_smoothing_channels,
    "route-to-strongest": has_routing,
    "request-sharing": has_requests,
    "set-points": has_set_points,
    "static": has_set_points,
    "two-timescale": has_set_points,
    "mpc": is_priced_by_models,
    "mpc-one-step": is_priced_by_models,
    "mpc-messages": is_priced_by_models,
    "feedback": is_priced_by_models,
    "model-aided": is_known_to_models,
}
NEEDING_A_DEVICE = (
    "peak-shaving", "return-by-hand", "staggered-return", "smoothing", "smoothing-light", "smoothing-strong",
    "route-to-strongest", "request-sharing", "set-points", "static", "two-timescale",
)  # fmt: skip
"""Controllers that refuse a scenario of data centres and inverters alone."""


def has_policy(preset: str) -> bool:
    """Whether policies that were trained on a preset ship."""
    return not preset.endswith("-published")


def ships(law: str, preset: Scenario) -> bool:
    """Whether parameters of a law ship for a preset: constant set points do where agents choose them."""
    chosen = not TUNABLE[law].by_cross_entropy or agents_choose_set_points(preset)
    return chosen and TUNABLE[law].fits(preset)


def drives(name: str, scenario: Scenario) -> bool:
    """Whether a controller can drive a preset, and a tuned one has parameters that ship."""
    if name.endswith("-tuned"):
        return ships(name.removesuffix("-tuned"), scenario)
    return NEEDS.get(name, lambda _: True)(scenario)
