"""Settings that several commands take, checked in one way."""

from __future__ import annotations

from pathlib import Path


def processes(jobs: int | None) -> int:
    """How many processes to work with, one for each core by default; ValueError below 1."""
    from dcgrid_env.powerflow.threads import n_threads

    if jobs is None:
        return n_threads()
    if jobs < 1:
        raise ValueError(f"jobs is {jobs}; give at least 1")
    return jobs


def make_folder(folder: Path) -> None:
    """Make a folder for what will be written, before the work for it is done; ValueError where that cannot be."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"out: no folder {folder} can be made ({error.strerror}); choose another --out") from None
