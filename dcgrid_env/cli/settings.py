"""Settings that several commands take, checked in one way."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from dcgrid_env.core.files import new_folder, require_folder
from dcgrid_env.core.lock import locked

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from dcgrid_env import Scenario

Overrides = Annotated[tuple[str, ...], tyro.conf.arg(metavar="FIELD=VALUE ...")]
"""Fields of the scenario that are to be otherwise."""
Scenarios = Annotated[str, tyro.conf.arg(aliases=("--scenario",))]
"""Scenarios separated by commas; who has one alone may leave out the s."""


def with_horizon(changes: tuple[str, ...], horizon: int | None) -> tuple[str, ...]:
    """Fields that are to be otherwise with an option ``--horizon``; ValueError where both say the length."""
    if horizon is None:
        return changes
    if any(change.partition("=")[0].strip() == "horizon" for change in changes):
        raise ValueError(f"horizon is given by --horizon {horizon} and by --set; leave one of them out")
    return (*changes, f"horizon={horizon}")


def at_least(settings: object, **least: float) -> None:
    """ValueError, naming it, for the first field of a command that is below the least value given for it, or NaN."""
    for field, value in least.items():
        if not getattr(settings, field) >= value:
            raise ValueError(f"{field} is {getattr(settings, field)}; give at least {value}")


def check_folder(folder: Path) -> None:
    """ValueError unless a folder can be made for what will be written, before the work for it is done.

    It is made when there is something to write, so that an error or Ctrl-C leaves none that is empty.
    """
    try:
        require_folder(folder)
    except OSError as error:
        raise ValueError(f"out: no folder {folder} can be made ({error.strerror}); choose another --out") from None


def check_file(field: str, path: Path) -> None:
    """ValueError, naming the field, unless a file can be written there, before the work for it is done."""
    if path.is_dir():
        raise ValueError(f"{field} is {str(path)!r}, which is a folder; give a file")
    try:
        require_folder(path.parent)
    except OSError as error:
        raise ValueError(f"{field}: no folder {path.parent} can be made ({error.strerror}); give another") from None


@contextmanager
def alone_in(folder: Path, what: str) -> Iterator[None]:
    """Hold a folder that is read, changed and written again, so that two commands at once lose nothing of each other.

    ``what`` says who holds it. ValueError where the folder cannot be made, LockedError where another command holds it.
    """
    check_folder(folder)
    with new_folder(folder), locked(folder, what, "wait until it has ended, or work in another folder"):
        yield


def tuned_from(controllers: Sequence[str], scenario: Scenario, tuned: Path | None) -> list[str]:
    """Lines that name the tuned controllers whose gains come from a file and are not the bundled ones."""
    from dcgrid_env.baselines import TUNED
    from dcgrid_env.baselines.tuning.tunable import TUNABLE
    from dcgrid_env.baselines.tuning.tuned import SUFFIX, tuned_parameters

    laws = {name: name.removesuffix(SUFFIX) for name in controllers if name in TUNED}
    # A law that the scenario has nothing for is refused when it is given it, and has no gains.
    fitting = {name: law for name, law in laws.items() if TUNABLE[law].fits(scenario)}
    files = {name: tuned_parameters(law, scenario, tuned).file for name, law in fitting.items()}
    return [f"{name}: gains of {scenario.name} from {file}" for name, file in files.items() if file is not None]
