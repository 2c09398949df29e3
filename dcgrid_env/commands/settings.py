"""Settings that several commands take, checked in one way."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from dcgrid_env.files import require_folder

if TYPE_CHECKING:
    from rich.console import Console


def plain_console() -> Console:
    """A console on what is standard output now, wherever that of a training goes.

    It shows text as it is: what users name may hold brackets, or ``:key:``.
    """
    from rich.console import Console

    return Console(file=sys.stdout, markup=False, emoji=False, highlight=False)


def processes(jobs: int | None) -> int:
    """How many processes to work with, one for each core by default; ValueError below 1."""
    from dcgrid_env.powerflow.threads import n_threads

    if jobs is None:
        return n_threads()
    if jobs < 1:
        raise ValueError(f"jobs is {jobs}; give at least 1")
    return jobs


def check_folder(folder: Path) -> None:
    """ValueError unless a folder can be made for what will be written, before the work for it is done.

    It is made when there is something to write, so that an error or Ctrl-C leaves none that is empty.
    """
    try:
        require_folder(folder)
    except OSError as error:
        raise ValueError(f"out: no folder {folder} can be made ({error.strerror}); choose another --out") from None
