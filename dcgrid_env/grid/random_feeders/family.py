"""Family of random feeders: the feeder of a scenario in which each batch of episodes has another one."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from dcgrid_env.core.checked import choice, count, number, refuse, settle
from dcgrid_env.grid.balanced_nodes import OneNodeABus
from dcgrid_env.grid.feeder import Feeder
from dcgrid_env.grid.network import BusId, bus_text
from dcgrid_env.grid.random_feeders.drawn import LARGEST_REACH_PU
from dcgrid_env.grid.random_feeders.random_feeder import random_feeder
from dcgrid_env.grid.random_feeders.styles import STYLES, own_buses
from dcgrid_env.grid.topology import FeederError

HELD_OUT = 64
"""Feeders of the validation, the test and the ood split each."""
OF_OTHER_STYLE = "ood"
"""The split whose feeders are of another style."""
_OF_ONE = ("p_load_kw", "q_load_kvar", "r_ohm", "x_ohm", "r_pu", "x_pu", "parent", "path", "depth_first", "x", "y")


@dataclass(frozen=True)
class RandomFeeders(OneNodeABus):
    """Random feeders of one style, number of buses and peak load, for the ``feeder`` of a scenario.

    An episode's seed selects its feeder. In the train split ``batch`` consecutive seeds share a feeder, starting with
    seeds 0 to ``batch - 1``. A batch of episodes is therefore one batch of power flows, and the next episode of each
    environment is on another feeder. Validation, test and ood have 64 feeders each, and seed s is on feeder s % 64
    there. No feeder is in two splits. ``Scenario.member(seed)`` is the scenario on the feeder of a seed.

    All members have the same bus names, the same number of nodes and the same total load. A rating in kW is therefore
    the same share of the load on all of them.
    """

    n_bus: int = count(10, 100_000, default=60)  # pyright: ignore[reportAssignmentType] (a property of one feeder)
    """Buses of each feeder, the substation among them."""
    style: str = choice(*STYLES, default="urban")
    """Statistics that they are drawn by, see :func:`random_feeder`."""
    load_kw: float = number(1.0, 1e6, default=4000.0)
    """Sum of the loads of each feeder at peak, kW, before rounding."""
    ood: str | None = "rural"
    """Style of the split ood, another than ``style``; None for no such split."""
    batch: int = count(1, 1_000_000, default=128)
    """Seeds in a row of the train split that share a feeder."""

    version: int = choice(1, default=1)
    """Version of the generator; another one draws other feeders."""

    def __post_init__(self) -> None:
        settle(self)
        if self.ood is not None and (self.ood not in STYLES or self.ood == self.style):
            others = ", ".join(style for style in STYLES if style != self.style)
            raise refuse(self, "ood", f"choose one of {others}, or None")

    @property
    def name(self) -> str:
        """Name of the family in tables and messages."""
        return f"random-{self.style}-{self.n_bus}"

    @cached_property
    def bus_ids(self) -> tuple[str, ...]:
        """Names of the buses, which all members share: "0", the substation, "1" and so on, depth first."""
        return own_buses(self.n_bus)

    def index(self, bus: BusId) -> int:
        """Position of a bus in ``bus_ids``; FeederError where there is none."""
        text = bus_text(bus)
        if text.isdigit() and str(int(text)) == text and int(text) < self.n_bus:
            return int(text)
        raise FeederError(f"feeder {self.name!r} has no bus {bus!r}; its buses are 0 to {self.n_bus - 1}")

    @cached_property
    def capacitor_kvar(self) -> np.ndarray:
        """Shunt capacitors, kvar, (n_bus,): random feeders have none."""
        return np.zeros(self.n_bus)

    @property
    def least_loaded(self) -> int:
        """Buses with a load that every member has at least."""
        styles = [STYLES[name] for name in (self.style, self.ood) if name]
        return min(style.n_loaded(self.n_bus) for style in styles)

    @property
    def largest_drop_pu_per_mw(self) -> float:
        """What no R_ii and no X_ii of any member exceeds, p.u. of voltage for each MW or Mvar."""
        return LARGEST_REACH_PU * 1000.0 / self.load_kw

    def style_of(self, split: str) -> str:
        """The style of a split's feeders; FeederError for ood where there is none."""
        if split != OF_OTHER_STYLE:
            return self.style
        if self.ood is None:
            raise FeederError(f"feeder {self.name!r} has no style for the split 'ood'; give ood")
        return self.ood

    def keys(self, split: str, seeds: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """The feeder of each episode, as the seed that ``random_feeder`` takes, uint64.

        ``seeds`` and ``numbers``, the episodes since each seed, are (row,) uint64.
        """
        from dcgrid_env.core import random  # brings the compiler with it, so not on import

        salt = np.uint64(zlib.crc32(f"feeders of {split}".encode()))
        if split == "train":
            return random.keys(salt, seeds // np.uint64(self.batch), numbers)
        held_out = (seeds % np.uint64(HELD_OUT) + numbers % np.uint64(HELD_OUT)) % np.uint64(HELD_OUT)
        return random.keys(salt, held_out, np.zeros_like(held_out))

    def feeder(self, split: str, key: int) -> Feeder:
        """The member of a key; the last ones asked for are kept."""
        return _member(self, self.style_of(split), int(key))

    def __getattr__(self, name: str) -> Any:
        if name in _OF_ONE:
            raise AttributeError(
                f"RandomFeeders has no {name}: it is many feeders; Scenario.member(seed).feeder is the one of a seed"
            )
        raise AttributeError(f"RandomFeeders has no attribute {name!r}")


@lru_cache(maxsize=256)
def _member(family: RandomFeeders, style: str, key: int) -> Feeder:
    return random_feeder(key, n_bus=family.n_bus, style=style, load_kw=family.load_kw)
