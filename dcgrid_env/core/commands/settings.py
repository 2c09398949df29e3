"""Options that several commands share, and their checks."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from dcgrid_env.core.files import new_folder, require_folder, require_replaceable
from dcgrid_env.core.lock import locked

if TYPE_CHECKING:
    from collections.abc import Iterator

Overrides = Annotated[tuple[str, ...], tyro.conf.arg(metavar="FIELD=VALUE ...")]
"""Scenario fields to override."""
Scenarios = Annotated[str, tyro.conf.arg(aliases=("--scenario",))]
"""Scenarios, separated by commas; ``--scenario`` is an alias of the option."""


def with_horizon(changes: tuple[str, ...], horizon: int | None) -> tuple[str, ...]:
    """Add ``--horizon`` to the fields to override; raise ValueError if both set the horizon."""
    if horizon is None:
        return changes
    if any(change.partition("=")[0].strip() == "horizon" for change in changes):
        raise ValueError(f"horizon: must be set once, got --horizon {horizon} and --set horizon; remove one of them")
    return (*changes, f"horizon={horizon}")


def at_least(settings: object, **least: float) -> None:
    """Raise ValueError for the first field that is NaN or below its least value; the message names the field."""
    for field, value in least.items():
        if not getattr(settings, field) >= value:
            raise ValueError(f"{field}: must be at least {value}, got {getattr(settings, field)}")


def check_folder(folder: Path) -> None:
    """Raise ValueError if an output folder cannot be created; call it before the work starts.

    The folder is created later, when there is something to write. An error or Ctrl-C therefore leaves no empty folder.
    """
    try:
        require_folder(folder)
    except OSError as error:
        raise ValueError(
            f"out: must be a folder that can be created, got {folder} ({error.strerror}); choose another --out"
        ) from None


def check_file(field: str, path: Path) -> None:
    """Raise ValueError if an output file cannot be written; call it before the work starts."""
    if path.is_dir():
        raise ValueError(f"{field}: must be a file, got the folder {str(path)!r}")
    try:
        require_replaceable(path)
    except OSError as error:
        raise ValueError(f"{field}: {error}") from None
    try:
        require_folder(path.parent)
    except OSError as error:
        raise ValueError(
            f"{field}: must be in a folder that can be created, got {path.parent} ({error.strerror}); choose another"
        ) from None


@contextmanager
def alone_in(folder: Path, what: str) -> Iterator[None]:
    """Lock a folder while a command changes it, so two commands cannot overwrite each other's results.

    ``what`` is the command's name in error messages. Raises ValueError if the folder cannot be created, and
    LockedError if another command has locked it.
    """
    check_folder(folder)
    with new_folder(folder), locked(folder, what, "wait until it has ended, or use another folder"):
        yield
