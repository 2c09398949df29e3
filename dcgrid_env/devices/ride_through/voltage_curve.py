"""Ride-through curves: time that a device stays connected at a voltage that is too low or too high.

A curve is two tables of pairs (voltage in p.u., seconds): a voltage below an undervoltage threshold, or above one of
overvoltage, is ridden through for that time; the deepest threshold that a voltage has passed decides. Between the
mildest thresholds a device stays connected indefinitely.

| name | below, p.u.: s | above, p.u.: s | source |
|---|---|---|---|
| itic | 0.9: 10, 0.8: 0.5, 0.7: 0.02 | 1.1: 0.5, 1.2: 0.003, 1.4: 0.001 | ITI (CBEMA) curve, 2000 (a) |
| ercot-2026 | 0.9: 2, 0.8: 0.5, 0.5: 0.25, 0.2: 0.15 | 1.1: 2, 1.2: 0 | ERCOT NOGRR 282, loads of 75 MW and more (b) |
| ieee1547-cat2 | 0.88: 10, 0.45: 0.16 | 1.1: 2, 1.2: 0.16 | IEEE 1547, category II (c) |
| caiso-proposal | 0.9: 6, 0.7: 3, 0.5: 1.2, 0.25: 0.15 | 1.1: 2, 1.2: 0 | CAISO straw proposal for large loads (d) |

(a) From a textbook's figure: 0 % for 20 ms, 70 % for 0.5 s, 80 % for 10 s, 120 % for 0.5 s. Chosen here: the figure's
steep end above 120 % as two steps.
(b) From a secondary source, from August 2026 on. Chosen here: no time above 1.2, which it does not cover.
(c) Settled by a draft of the standard: 0.88 to 1.10 indefinitely, above 1.2 a trip within 0.16 s. Chosen here: the
category's default trip times for the rest, its undervoltage 1 of 10 s from the edge of continuous operation.
(d) From a secondary source, which covers only undervoltage. Chosen here: ERCOT's overvoltage.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from dcgrid_env.core.checked import FieldError, Plain, finite

Threshold = tuple[float, float]
"""Voltage, p.u., and time for which voltages beyond it are ridden through, s."""


@dataclass(frozen=True)
class RideThroughCurve:
    """Custom curve; FieldError for one that is not monotone. Plain form: a name, or a mapping of the fields."""

    under: tuple[Threshold, ...] = ()
    """Undervoltage: pairs (p.u., s), voltages falling from below 1, times not rising."""
    over: tuple[Threshold, ...] = ()
    """Overvoltage: pairs (p.u., s), voltages rising from above 1, times not rising."""

    def __post_init__(self) -> None:
        for name, sign in (("under", -1.0), ("over", 1.0)):
            object.__setattr__(self, name, _table(name, getattr(self, name), sign))
        if not self.under and not self.over:
            raise FieldError("RideThroughCurve", "under", self.under, "give a threshold here or in over")


def _table(name: str, values: Any, sign: float) -> tuple[Threshold, ...]:
    """Return a table as a tuple of pairs; FieldError for other values, or a table that is not monotone."""
    side = "falling from below 1 p.u." if sign < 0 else "rising from above 1 p.u."
    values = values.tolist() if isinstance(values, np.ndarray) else values
    if not isinstance(values, list | tuple) or not all(isinstance(p, list | tuple) and len(p) == 2 for p in values):
        raise FieldError("RideThroughCurve", name, values, "give pairs of a voltage in p.u. and seconds")
    table = tuple(tuple(pair) for pair in values)
    for v_pu, time_s in table:
        if not finite(v_pu, 0.0, 10.0) or sign * (v_pu - 1.0) <= 0.0:
            raise FieldError("RideThroughCurve", name, values, f"the voltage {v_pu!r} cannot be; give them {side}")
        if not finite(time_s, 0.0, 1e9):
            raise FieldError(
                "RideThroughCurve", name, values, f"the time {time_s!r} cannot be; give seconds of at least 0"
            )
    for (v_before, s_before), (v_pu, time_s) in pairwise(table):
        if sign * (v_pu - v_before) <= 0.0:
            raise FieldError("RideThroughCurve", name, values, f"{v_pu!r} follows {v_before!r}; give voltages {side}")
        if time_s > s_before:
            remedy = f"{time_s!r} s follows {s_before!r} s; what is farther from 1 p.u. cannot be ridden through longer"
            raise FieldError("RideThroughCurve", name, values, remedy)
    return tuple((float(v_pu), float(time_s)) for v_pu, time_s in table)


CURVES: dict[str, RideThroughCurve] = {
    "itic": RideThroughCurve(
        under=((0.9, 10.0), (0.8, 0.5), (0.7, 0.02)), over=((1.1, 0.5), (1.2, 0.003), (1.4, 0.001))
    ),
    "ercot-2026": RideThroughCurve(
        under=((0.9, 2.0), (0.8, 0.5), (0.5, 0.25), (0.2, 0.15)), over=((1.1, 2.0), (1.2, 0.0))
    ),
    "ieee1547-cat2": RideThroughCurve(under=((0.88, 10.0), (0.45, 0.16)), over=((1.1, 2.0), (1.2, 0.16))),
    "caiso-proposal": RideThroughCurve(
        under=((0.9, 6.0), (0.7, 3.0), (0.5, 1.2), (0.25, 0.15)), over=((1.1, 2.0), (1.2, 0.0))
    ),
}
"""Named curves; the module lists their sources."""


class Elements:
    """Curves of several slots as arrays: one element for each threshold, as a protective relay has them.

    An element picks up while the voltage is beyond its threshold. Slots with fewer thresholds than others have
    elements that never pick up.
    """

    def __init__(self, curves: tuple[RideThroughCurve, ...]):
        n_under, n_over = (max((len(getattr(c, side)) for c in curves), default=0) for side in ("under", "over"))
        under = [[*c.under, *[(-np.inf, np.inf)] * (n_under - len(c.under))] for c in curves]
        over = [[*c.over, *[(np.inf, np.inf)] * (n_over - len(c.over))] for c in curves]
        both = np.array([[*a, *b] for a, b in zip(under, over, strict=True)]).reshape(len(curves), n_under + n_over, 2)
        self.sign = np.array([1.0] * n_under + [-1.0] * n_over)
        """1 for an element of undervoltage and -1 for one of overvoltage, (n_element,)."""
        self.threshold = self.sign * both[..., 0]
        """Voltage times sign below which an element picks up, p.u., (slot, n_element)."""
        self.time_s = both[..., 1]
        """Time from pick-up to trip, s, (slot, n_element)."""
        self.n_under = n_under
        """Number of undervoltage elements, which come first."""

    @property
    def count(self) -> int:
        """Return the number of elements of each slot."""
        return len(self.sign)


def curves_of(value: object) -> Any:
    """Make a curve from a name or a mapping, or one for each entry of a list; return other values unchanged.

    FieldError for an unknown name or an invalid curve.
    """
    if isinstance(value, str):
        if value not in CURVES:
            raise FieldError("RideThroughCurve", "curve", value, f"choose one of {', '.join(CURVES)}, or give a table")
        return CURVES[value]
    if isinstance(value, Mapping):
        unknown = [key for key in value if key not in ("under", "over")]
        if unknown:
            raise FieldError("RideThroughCurve", "curve", dict(value), f"{unknown[0]!r} is no field; give under, over")
        return RideThroughCurve(**value)
    return tuple(map(curves_of, value)) if isinstance(value, list | tuple) else value


def plain_curve(curve: RideThroughCurve) -> Plain:
    """Return the plain form of a curve: its name, or its tables."""
    named = next((name for name, known in CURVES.items() if known == curve), None)
    return named or {"under": [list(pair) for pair in curve.under], "over": [list(pair) for pair in curve.over]}
