"""Base of groups of agents that command equipment of the feeder itself: without a bus or a converter."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.cache import PickledByFields
from dcgrid_env.devices.device import CostTerm, GridChange


class GridEquipment(PickledByFields):
    """Base class of the group that a scenario adds for equipment controlled by agents.

    The commands of such a group are read from its state and applied with those of equipment with its own control
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
        """Ones: equipment has no active power."""
        return np.ones(self.count)

    @property
    def converter_kva(self) -> np.ndarray:
        """Ones: equipment has no converter."""
        return np.ones(self.count)

    @property
    def q_limit_kvar(self) -> np.ndarray:
        """Zeros: equipment has no reactive power."""
        return np.zeros(self.count)

    @property
    def largest_draw_share(self) -> float:
        """Zero: equipment draws nothing."""
        return 0.0

    def cost_terms(self, horizon: int, dt_s: float) -> tuple[CostTerm, ...]:
        """Empty: the term ``switching`` belongs to the grid."""
        return ()

    def check_episode(self, horizon: int) -> None:
        """Accept any number of steps."""

    def grid_change(self, parameters: object, state: object) -> GridChange:
        """Return no change, see the class."""
        return GridChange()

    def amount(self, name: str, parameters: object, state: object) -> Array:
        """Raise KeyError: the group has no cost term."""
        raise KeyError(name)

    def totals(self, state: object) -> dict[str, Array]:
        """Return no figures for ``info``."""
        return {}

    def metrics(self, history: object, dt_s: float, requests: object) -> dict[str, float]:
        """Return no metrics in addition to those of all equipment."""
        return {}


def is_equipment(device: object) -> bool:
    """Return whether a group represents equipment of the feeder, which has no bus and no converter."""
    return isinstance(device, GridEquipment)
