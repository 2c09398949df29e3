"""Units of work, their results, and the common interface of the places that run units."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

TRIES = 3
"""Maximum number of attempts for a unit whose worker dies."""
GOES_ON = "the same command goes on from there"
"""Message that finished work is kept and not repeated."""
_NAMED = 10
"""Units that a message names before it counts the others."""

Item = TypeVar("Item")
Result = TypeVar("Result")


class Needs(NamedTuple):
    """Resources of a unit while it runs.

    On one machine the cores alone limit how many units run at once; a cluster uses all three.
    """

    cores: float = 1.0
    gpus: float = 0.0
    memory_gb: float = 0.0
    """0 where it does not matter."""


ONE_CORE = Needs()


@dataclass(frozen=True)
class Unit(Generic[Item, Result]):
    """Piece of work that depends only on its item, so it may run anywhere, and be repeated."""

    key: str
    """Name in messages, such as ``toy6, seed 3``."""
    work: Callable[[Item], Result]
    """A function of a module."""
    item: Item
    """Its argument; argument and result are sent as pickles."""
    needs: Needs = ONE_CORE


@dataclass(frozen=True)
class Lost:
    """Reason why a unit has no result; returned in its place."""

    reason: str
    """Reason on one line."""
    error: Exception | None = None
    """Exception that the work raised; None if its worker died each time."""


class LostUnits(ValueError):
    """Error for units without a result; the message names them, the reasons and how to continue."""

    @property
    def traced(self) -> bool:
        """Whether a traceback says more than the message: not where no work raised anything, but workers died."""
        return self.__cause__ is not None


class Place(ABC):
    """Where units run."""

    is_remote: ClassVar[bool]
    """Whether workers may be on machines that do not see this one's files."""

    @property
    @abstractmethod
    def workers(self) -> int:
        """How many units of one core each run at once, at least 1."""

    @abstractmethod
    def run(
        self, units: Sequence[Unit[Item, Result]], shared: Mapping[str, Any] | None = None
    ) -> Iterator[tuple[Unit[Item, Result], Result | Lost]]:
        """Run the units; each with its result, or why it has none, in the order in which they are done.

        A unit whose worker dies is tried again, at most ``TRIES`` times in total; a unit that raises is not. Leaving
        the iterator (Ctrl-C included) ends the workers.

        Parameters
        ----------
        units
            The units to run.
        shared
            Values that many units use, by name; ``worker.shared`` returns them to the work. They are sent once to a
            worker on this machine, and once to a node of a cluster, not with each unit.
        """

    def results(
        self,
        units: Sequence[Unit[Item, Result]],
        shared: Mapping[str, Any] | None = None,
        how_to_go_on: str = GOES_ON,
    ) -> Iterator[tuple[Unit[Item, Result], Result]]:
        """Run the units; each with its result. LostUnits at the end, when the others are done, where some have none."""
        lost: dict[str, Lost] = {}
        for unit, result in self.run(units, shared):
            if isinstance(result, Lost):
                lost[unit.key] = result
            else:
                yield unit, result
        require_all(lost, len(units), how_to_go_on)


def require_all(lost: Mapping[str, Lost], n_units: int, how_to_go_on: str = GOES_ON) -> None:
    """LostUnits where units, of ``n_units`` in all, have no result; ``lost`` has the reasons by the units' keys."""
    if not lost:
        return
    by_reason: dict[str, list[str]] = {}
    for key, one in lost.items():
        by_reason.setdefault(one.reason, []).append(key)
    said = "; ".join(f"{_listed(keys)}: {reason}" for reason, keys in by_reason.items())
    on = f"; {how_to_go_on}" if how_to_go_on else ""
    first = next((one.error for one in lost.values() if one.error is not None), None)
    raise LostUnits(f"{len(lost)} of {n_units} not done: {said}{on}") from first


def _listed(keys: Sequence[str]) -> str:
    more = len(keys) - _NAMED
    return " / ".join(keys[:_NAMED]) + (f" and {more} more" if more > 0 else "")
