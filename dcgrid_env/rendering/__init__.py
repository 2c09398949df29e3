"""Pictures: the feeder on its map, the curves of an episode, the figure of a run, a replay for the browser.

The names are imported when they are asked for: matplotlib takes long, and an environment that draws nothing needs none.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dcgrid_env.rendering.banded_figure import long_figure
    from dcgrid_env.rendering.bus_positions import positions
    from dcgrid_env.rendering.capacity_map import capacity_figure
    from dcgrid_env.rendering.envelope import Envelope
    from dcgrid_env.rendering.feeder_map import INK, draw_feeder
    from dcgrid_env.rendering.replay_page import Replay, replay
    from dcgrid_env.rendering.side_by_side import run_figure

__all__ = [
    "INK",
    "Envelope",
    "Replay",
    "capacity_figure",
    "draw_feeder",
    "long_figure",
    "positions",
    "replay",
    "run_figure",
]

_MODULES = {
    "Envelope": "envelope",
    "INK": "feeder_map",
    "Replay": "replay_page",
    "capacity_figure": "capacity_map",
    "draw_feeder": "feeder_map",
    "long_figure": "banded_figure",
    "positions": "bus_positions",
    "replay": "replay_page",
    "run_figure": "side_by_side",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
