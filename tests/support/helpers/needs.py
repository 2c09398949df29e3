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


MODELS = ("feedback", "mpc-one-step", "mpc")
"""Controllers with a model, which refuse sites that draw something else than what their work takes."""


def drives(name: str, scenario: Scenario) -> bool:
    """Whether a scenario has the channel that a controller needs, if any, and nothing that it refuses."""
    if name in MODELS and any(getattr(scenario.part("datacenter"), field) for field in ("smoothing", "cooling")):
        return False
    needed = NEEDS.get(name.removesuffix("-tuned"))
    return needed is None or bool(action_layout(scenario).is_channel(needed).any())
