"""Units of work, their results, and the common interface of the places that run units."""

from __future__ import annotations

import contextlib
import sys
import sysconfig
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

import cloudpickle

GOES_ON = "run the same command again: finished units are kept"
_LIBRARIES = ("OMP", "OPENBLAS", "MKL", "NUMBA", "DCGRID")
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in _LIBRARIES}
"""Environment variables of a worker."""
_LISTED = 10
"""Number of units that a message lists."""

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Unit(Generic[Item, Result]):
    """Piece of work that depends only on its item, so it may run anywhere, and be repeated."""

    key: str
    """Name in messages, such as ``toy6, seed 3``."""
    work: Callable[[Item], Result]
    """A function of a module."""
    item: Item
    """Its argument; argument and result are sent as pickles."""
    cores: int = 1
    gpus: int = 0
    """Number of GPUs, which only a cluster counts."""


@dataclass(frozen=True)
class Lost:
    """Reason why a unit has no result, and the traceback of an error; returned in place of the result."""

    reason: str
    trace: str = ""


class LostUnits(ValueError):
    """Error for units without a result; the message names them, the reasons and the remedy."""

    traced = False
    """Whether a traceback contains more than the message."""


@dataclass(frozen=True)
class Place(ABC):
    """Where units run."""

    workers: int = 1
    """Number of units of one core that run at once."""
    is_remote: ClassVar[bool]
    """Whether workers may be on machines without this machine's files."""

    @abstractmethod
    def run(
        self, units: Sequence[Unit[Item, Result]], shared: Mapping[str, Any] | None = None
    ) -> Iterator[tuple[Unit[Item, Result], Result | Lost]]:
        """Run the units; yield each with its result, or why it has none, in the order in which they end.

        ``shared`` are values that many units use, by name. Each worker or node receives them once, and ``shared``
        returns them to the work. Leaving the iterator (Ctrl-C included) ends the workers.
        """

    def results(
        self,
        units: Sequence[Unit[Item, Result]],
        shared: Mapping[str, Any] | None = None,
        how_to_go_on: str = GOES_ON,
    ) -> Iterator[tuple[Unit[Item, Result], Result]]:
        """Run the units; yield each with its result. Raise LostUnits after the others if some have none."""
        lost: dict[str, Lost] = {}
        for unit, result in self.run(units, shared):
            if isinstance(result, Lost):
                lost[unit.key] = result
            else:
                yield unit, result
        require_all(lost, len(units), how_to_go_on)


def require_all(lost: Mapping[str, Lost], n_units: int, how_to_go_on: str = GOES_ON) -> None:
    """Raise LostUnits if units, of ``n_units`` in total, have no result; ``lost`` has the reasons by their keys."""
    if not lost:
        return
    reasons: dict[str, list[str]] = {}
    for key, one in lost.items():
        reasons.setdefault(one.reason, []).append(key)
    parts = [f"{len(lost)} of {n_units} not done"]
    for reason, keys in reasons.items():
        more = f" and {len(keys) - _LISTED} more" if len(keys) > _LISTED else ""
        parts.append(f"{' / '.join(keys[:_LISTED])}{more}: {reason}")
    error = LostUnits("; ".join(filter(None, [": ".join(parts[:2]), *parts[2:], how_to_go_on])))
    if trace := next((one.trace for one in lost.values() if one.trace), ""):
        error.traced = True
        error.add_note(trace)
    raise error


def attempt(work: Callable[[Item], Result], item: Item) -> Result | Lost:
    """Return the result of a unit, or the error that it raised as text, because not every error can be pickled."""
    try:
        return work(item)
    except (Exception, SystemExit) as error:  # user code may raise SystemExit
        reason = " ".join(str(error).split())
        if not isinstance(error, ValueError | OSError) or not reason:
            reason = f"{type(error).__name__}: {reason}".removesuffix(": ")
        return Lost(reason, "".join(traceback.format_exception(error)))


_values: dict[str, Any] = {}


def shared(name: str, default: object = None) -> Any:
    """Return a value that the units of this run share, by its name; ``default`` if there is none."""
    return _values.get(name, default)


def share(values: Mapping[str, Any]) -> dict[str, Any]:
    """Let units that this process runs from now on share these values; return the earlier ones."""
    before = dict(_values)
    _values.clear()
    _values.update(values)
    return before


def packed(values: Iterable[Any]) -> list[bytes]:
    """Pickle values with functions and classes of the user's modules whole, because workers may lack these modules."""
    with contextlib.ExitStack() as stack:
        for module in [module for name, module in sys.modules.items() if _is_user_module(name, module)]:
            cloudpickle.register_pickle_by_value(module)
            stack.callback(cloudpickle.unregister_pickle_by_value, module)
        return [cloudpickle.dumps(value) for value in values]


def _is_user_module(name: str, module: Any) -> bool:
    """Return whether a module is neither installed nor of this package."""
    file = getattr(module, "__file__", None)
    if not file or name != module.__name__ or name.partition(".")[0] in (__name__.partition(".")[0], "__main__"):
        return False
    path = Path(file)
    installed = {"site-packages", "dist-packages"} & set(path.parts)
    return not installed and Path(sysconfig.get_paths()["stdlib"]) not in path.parents
