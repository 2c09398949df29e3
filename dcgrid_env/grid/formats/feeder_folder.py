"""The files of a feeder's folder: which kind of feeder they hold, and how a new feeder replaces them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from dcgrid_env.core.files import new_folder, write_text
from dcgrid_env.core.lock import locked
from dcgrid_env.grid.formats.ratings_file import RATINGS_FILE
from dcgrid_env.grid.formats.three_phase_columns import FILES
from dcgrid_env.grid.topology import FeederError


def is_three_phase(folder: Path) -> bool:
    """Whether a folder holds a three-phase feeder (lines.csv, loads.csv, ..) and no balanced one (branches.csv).

    Raises
    ------
    FeederError
        For a folder with files of both kinds.
    """
    files = [file.name for file in FILES.values() if (folder / file.name).exists()]
    if files and (folder / "branches.csv").exists():
        raise FeederError(
            f"{folder}: branches.csv is of balanced feeders and {files[0]} of three-phase ones; keep one kind"
        )
    return bool(files)


def write_files(folder: Path, tables: Mapping[str, str], head: str) -> None:
    """Write the tables and ``feeder.toml`` of a feeder; tables of an earlier feeder in the folder are deleted.

    ``feeder.toml`` makes a folder a feeder, so it is deleted first and written last. The folder is locked meanwhile, so
    two feeders do not mix.

    Raises
    ------
    FeederError
        If the folder has no ``feeder.toml`` but another table, of another program or of an interrupted writing, that
        would be read with the new feeder. Nothing is written then.
    LockedError
        If another process writes a feeder there.
    """
    with new_folder(folder), locked(folder, "feeder's export", "give another folder, or wait until it has ended"):
        _write(folder, tables, head)


def _write(folder: Path, tables: Mapping[str, str], head: str) -> None:
    feeder_file = folder / "feeder.toml"
    others = {"branches.csv", RATINGS_FILE, *(file.name for file in FILES.values())} - set(tables)
    stale = [folder / name for name in sorted(others) if (folder / name).exists()]
    if stale and not feeder_file.exists():
        raise FeederError(
            f"{folder} has {stale[0].name} and no feeder.toml, and the table would be read with the new feeder; give "
            "an empty folder, or delete the table"
        )
    feeder_file.unlink(missing_ok=True)
    for path in stale:
        path.unlink()
    for name, text in tables.items():
        write_text(folder / name, text)
    write_text(feeder_file, head)
