"""The named feeders that ship with the package; each one's source stands in its feeder.toml."""

from __future__ import annotations

from functools import cache
from importlib.resources import as_file, files

from dcgrid_env.grid.feeder import Feeder
from dcgrid_env.grid.topology import FeederError

FEEDERS: dict[str, str] = {
    "toy6": "6 buses in the shape of the paper's Fig. 3 example",
    "ieee33": "Baran and Wu 1989, 33 buses, 12.66 kV",
    "das69": "PG&E 69-bus feeder (Baran and Wu 1989; figures of Das 2008), 12.66 kV",
    "ieee123": "balanced single-phase equivalent of the IEEE 123 node feeder, 123 buses, 4.16 kV",
    "khodr141": "Khodr et al. 2008, metropolitan Caracas, 141 buses, 12.47 kV",
}


@cache
def load_feeder(name: str) -> Feeder:
    """One of the named feeders (see ``FEEDERS``). The same frozen object at each call.

    Raises
    ------
    FeederError
        For an unknown name, listing those that exist.
    """
    if name not in FEEDERS:
        raise FeederError(f"unknown feeder {name!r}; there are {', '.join(FEEDERS)}; your own: Feeder.from_csv(folder)")
    with as_file(files("dcgrid_env.grid.data") / name) as folder:
        return Feeder.from_csv(folder)
