"""A unit of work, what becomes of it, and the places that run units, all alike."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

TRIES = 3
"""How often a unit is tried whose worker dies: once, and then at most twice again."""
GOES_ON = "the same command goes on from there"
"""What is said where what was done is kept and not done again."""
_NAMED = 10
"""Units that a message names before it counts the others."""

Item = TypeVar("Item")
Result = TypeVar("Result")


class Needs(NamedTuple):
    """What a unit takes while it runs.

    On one machine the cores alone limit how many units run at once; a cluster heeds all three.
    """

    cores: float = 1.0
    gpus: float = 0.0
    memory_gb: float = 0.0
    """0 where it does not matter."""


ONE_CORE = Needs()


@dataclass(frozen=True)
class Unit(Generic[Item, Result]):
    """A piece of work that depends on nothing but its item, so that it may be done anywhere, and again."""

    key: str
    """What messages call it, such as ``toy6, seed 3``."""
    work: Callable[[Item], Result]
    """A function of a module."""
    item: Item
    """Its argument; argument and result are sent as pickles."""
    needs: Needs = ONE_CORE


@dataclass(frozen=True)
class Lost:
    """In place of a unit's result: why there is none."""

    reason: str
    """On one line."""
    error: Exception | None = None
    """What the work raised; None where its worker died each time."""


class LostUnits(ValueError):
    """Some units have no result; the message names them, says why, and how to go on."""

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

        A unit whose worker dies is tried again, at most ``TRIES`` times in all; what the work raises is not. Leaving
        the iterator (Ctrl-C included) ends the workers.

        Parameters
        ----------
        units
            What is to be done.
        shared
            Values that many units use, by their names; ``worker.shared`` gives them to the work. They travel once to a
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
