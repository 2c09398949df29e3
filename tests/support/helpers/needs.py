"""What controllers need of a scenario to drive it at all."""

from dcgrid_env import Scenario, action_layout

NEEDS = {
    "peak-shaving": "p",
    "smoothing": "floor",
    "smoothing-light": "floor",
    "smoothing-strong": "floor",
    "return-by-hand": "return",
    "staggered-return": "return",
}
"""The channel without which a controller refuses a scenario, by the controller's name, tuned or not."""


def drives(name: str, scenario: Scenario) -> bool:
    """Whether a scenario has the channel that a controller needs, if any."""
    needed = NEEDS.get(name.removesuffix("-tuned"))
    return needed is None or bool(action_layout(scenario).is_channel(needed).any())
