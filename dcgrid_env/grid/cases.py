"""The bundled feeders by name; the feeder.toml of each contains its source."""

from __future__ import annotations

from functools import cache, partial
from importlib.resources import as_file, files
from typing import Any

from dcgrid_env.core.plugins import Entry, Registry
from dcgrid_env.grid.feeder import Feeder
from dcgrid_env.grid.folder import read_feeder
from dcgrid_env.grid.three_phase import ThreePhaseFeeder
from dcgrid_env.grid.topology import FeederError

FEEDERS: dict[str, str] = {
    "toy6": "6 buses in the shape of the paper's Fig. 3 example",
    "ieee33": "Baran and Wu 1989, 33 buses, 12.66 kV",
    "das69": "PG&E 69-bus feeder (Baran and Wu 1989; figures of Das 2008), 12.66 kV",
    "ieee123": "balanced single-phase equivalent of the IEEE 123 node feeder, 123 buses, 4.16 kV",
    "khodr141": "Khodr et al. 2008, metropolitan Caracas, 141 buses, 12.47 kV",
    "ieee13-3ph": "IEEE 13 node test feeder, three-phase unbalanced, 4.16 kV",
    "ieee34-3ph": "IEEE 34 node test feeder, three-phase unbalanced, 24.9 kV",
    "ieee123-3ph": "IEEE 123 node test feeder, three-phase unbalanced, 4.16 kV",
}
"""Bundled feeders by name, each with one line about it."""


def _read(name: str) -> Feeder | ThreePhaseFeeder:
    with as_file(files("dcgrid_env.grid.data") / name) as folder:
        return read_feeder(folder)


ENTRIES: dict[str, Entry] = {name: (about, partial(_read, name)) for name, about in FEEDERS.items()}
"""The feeders of ``FEEDERS`` as entries of the registry."""
FEEDER_REGISTRY = Registry("dcgrid.feeders", "feeder", (Feeder, ThreePhaseFeeder), ENTRIES)
"""All feeders that have a name, those of other packages too."""


@cache
def load_feeder(name: str) -> Any:
    """Load a feeder that has a name: one of ``FEEDERS``, or of another package's entry points ``dcgrid.feeders``.

    Each call gives the same frozen object, a ``Feeder`` or, for the names that end in ``-3ph``, a ``ThreePhaseFeeder``.

    Raises
    ------
    FeederError
        For an unknown name, naming similar ones.
    PluginError
        Where another package's feeder cannot be made.
    """
    if name not in FEEDER_REGISTRY:
        raise FeederError(f"{FEEDER_REGISTRY.unknown(name)}; your own: Feeder.from_csv(folder)")
    return FEEDER_REGISTRY.make(name)


def is_bundled(feeder: Feeder | ThreePhaseFeeder) -> bool:
    """Whether a feeder is one of ``FEEDERS``, unchanged and as ``load_feeder`` returns it."""
    return feeder.name in FEEDERS and feeder is load_feeder(feeder.name)
