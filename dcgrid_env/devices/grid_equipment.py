"""What groups of agents have in common that command equipment of the feeder itself: no bus taken, no converter."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.cache import PickledByFields
from dcgrid_env.devices.device import CostTerm, GridChange


class GridEquipment(PickledByFields):
    """A group that a scenario gets by itself for the equipment that is to be agents; a base class.

    What such a group commands is read out of its state and set beside the equipment that has a control of its own
    (``engine.physics.equipment``), so ``grid_change`` is empty. Its moves are counted, charged and shown there too.
    """

    input: ClassVar[str | None] = None
    changes_grid: ClassVar[bool] = False
    names: tuple[str, ...]

    @property
    def count(self) -> int:
        """Number of agents."""
        return len(self.names)

    @property
    def p_scale_kw(self) -> np.ndarray:
        """A unit: there is no active power to be a share of."""
        return np.ones(self.count)

    @property
    def converter_kva(self) -> np.ndarray:
        """A unit: there is no converter."""
        return np.ones(self.count)

    @property
    def q_limit_kvar(self) -> np.ndarray:
        """No reactive power."""
        return np.zeros(self.count)

    @property
    def largest_draw_share(self) -> float:
        """It draws nothing."""
        return 0.0

    def cost_terms(self, horizon: int, dt_s: float) -> tuple[CostTerm, ...]:
        """Nothing of its own: the term ``switching`` is the grid's."""
        return ()

    def check_episode(self, horizon: int) -> None:
        """Nothing: it serves any episode."""

    def grid_change(self, parameters: Any, state: Any) -> GridChange:
        """Nothing, see the class."""
        return GridChange()

    def amount(self, name: str, parameters: Any, state: Any) -> Array:
        """KeyError: it has no cost term of its own."""
        raise KeyError(name)

    def totals(self, state: Any) -> dict[str, Array]:
        """Nothing to add to ``info``."""
        return {}

    def metrics(self, history: Any, dt_s: float, requests: Any) -> dict[str, float]:
        """Nothing beside what is measured of all equipment."""
        return {}


def is_equipment(device: Any) -> bool:
    """Whether a group stands for equipment of the feeder, which takes no bus and has no converter."""
    return isinstance(device, GridEquipment)
