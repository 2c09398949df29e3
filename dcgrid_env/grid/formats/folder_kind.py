"""Which kind of feeder a folder holds, by the files that are there."""

from __future__ import annotations

from pathlib import Path

from dcgrid_env.grid.formats.three_phase_columns import FILES
from dcgrid_env.grid.topology import FeederError


def is_three_phase(folder: Path) -> bool:
    """Whether a folder holds a three-phase feeder (lines.csv, loads.csv, ..) and no balanced one (branches.csv).

    Raises
    ------
    FeederError
        For a folder with files of both kinds.
    """
    found = [file.name for file in FILES.values() if (folder / file.name).exists()]
    if found and (folder / "branches.csv").exists():
        raise FeederError(
            f"{folder}: branches.csv is of balanced feeders and {found[0]} of three-phase ones; keep one kind"
        )
    return bool(found)
