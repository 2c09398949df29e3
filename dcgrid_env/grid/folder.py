"""Read a feeder of either kind from a folder."""

from __future__ import annotations

from pathlib import Path

from dcgrid_env.grid.feeder import Feeder
from dcgrid_env.grid.formats.feeder_folder import is_three_phase
from dcgrid_env.grid.three_phase import ThreePhaseFeeder

AnyFeeder = Feeder | ThreePhaseFeeder
"""A feeder of either kind."""


def read_feeder(folder: str | Path) -> AnyFeeder:
    """Read a balanced or three-phase feeder from a folder; its files define the kind.

    Raises
    ------
    FeederError
        Where ``Feeder.from_csv`` or ``ThreePhaseFeeder.from_csv`` has one, and for a folder with files of both kinds.
    """
    folder = Path(folder)
    return ThreePhaseFeeder.from_csv(folder) if is_three_phase(folder) else Feeder.from_csv(folder)
