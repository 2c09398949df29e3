"""Environments that are stepped together on different members of a family of random feeders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dcgrid_env.grid.balanced_nodes import OneNodeABus
from dcgrid_env.grid.feeder import Feeder
from dcgrid_env.grid.random_feeders.family import RandomFeeders


@dataclass(frozen=True, eq=False)
class FeederBatch(OneNodeABus):
    """The feeders of a batch of environments: the shared properties, and the feeder of each environment."""

    family: RandomFeeders
    members: tuple[tuple[Feeder, np.ndarray], ...]
    """Each feeder with the positions of its environments."""

    @property
    def name(self) -> str:
        """The family's."""
        return self.family.name

    @property
    def n_bus(self) -> int:
        """Number of buses, the substation among them."""
        return self.family.n_bus

    @property
    def bus_ids(self) -> tuple[str, ...]:
        """Names of the buses."""
        return self.family.bus_ids

    @property
    def capacitor_kvar(self) -> np.ndarray:
        """Shunt capacitors, kvar, (n_bus,): none."""
        return self.family.capacitor_kvar
