"""Short sags of the grid's voltage: events with a depth and a duration, too short to be steps of an episode.

During a sag, the voltage at a device is its voltage just before, multiplied by the share that remains at the source.
The whole feeder falls in proportion, as with constant impedances. Loads of constant power would lower their voltage
slightly more. A sag only decides which devices trip. The power flow of its step does not include it, because a sag ends
before it could affect clocks, taps or the averages of a step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from dcgrid_env.core.checked import FieldError, finite


@dataclass(frozen=True)
class Sag:
    """One sag of an episode, drawn evenly within its ranges; a single number is a range without width."""

    begin_s: tuple[float, float]
    """Earliest and latest beginning, s, see ``since``; a sag after the episode's end does not happen."""
    duration_s: tuple[float, float]
    """Shortest and longest duration, s."""
    retained_pu: tuple[float, float]
    """Lowest and highest voltage left at the source, as a share of that before, 0 .. 1."""
    since: str = "episode"
    """Reference of ``begin_s``: "episode", its beginning, or "previous", the beginning of the sag listed before."""

    def __post_init__(self) -> None:
        for name, highest in (("begin_s", 1e9), ("duration_s", 60.0), ("retained_pu", 1.0)):
            object.__setattr__(self, name, _range(name, getattr(self, name), highest))
        if self.duration_s[0] <= 0.0:
            raise FieldError("Sag", "duration_s", self.duration_s, "give a shortest above 0 s, or leave the sag out")
        if self.since not in ("episode", "previous"):
            raise FieldError("Sag", "since", self.since, "choose one of episode, previous")


def _range(name: str, value: Any, highest: float) -> tuple[float, float]:
    pair = (value, value) if finite(value) else value
    if not isinstance(pair, list | tuple) or len(pair) != 2 or not all(finite(v, 0.0, highest) for v in pair):
        raise FieldError("Sag", name, value, f"give a pair of numbers from 0 to {highest:g}, a lowest and a highest")
    low, high = pair
    if low > high:
        raise FieldError("Sag", name, value, "give the lowest first")
    return float(low), float(high)


def virginia_2024(begin_s: tuple[float, float] = (10.0, 30.0)) -> tuple[Sag, ...]:
    """The sags of 10 July 2024 in Virginia: six within 82 s, 42 to 66 ms each, 0.25 to 0.40 p.u. left.

    NERC, "Incident review: considering simultaneous voltage-sensitive load reductions", 2025. It gives their number,
    their span and these ranges. Chosen here: even spacing, and that each is drawn alone within the ranges.

    Parameters
    ----------
    begin_s
        Earliest and latest beginning of the first, s.
    """
    drawn: dict[str, Any] = {"duration_s": (0.042, 0.066), "retained_pu": (0.25, 0.40)}
    later = Sag(begin_s=(82.0 / 5, 82.0 / 5), since="previous", **drawn)
    return (Sag(begin_s=begin_s, **drawn), *(later,) * 5)


SAG_SEQUENCES = {"virginia-2024": virginia_2024}
"""Recorded sequences of sags by name."""
