"""Figures of an episode whose course comes in parts, so that none of it has to be kept.

A part is the state over some steps, from the end of the part before it on: one row more than it has steps, as
``Device.metrics`` takes them. The figures of parts become those of the episode by a rule for each of them. What no rule
joins, a quantile say, has an accumulator of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, Protocol

Rule = Literal["sum", "mean", "min", "max", "last"]
"""How the figures of parts become one; a mean is weighted, by the number of steps unless by something else."""

RULES: dict[str, Rule] = {
    **dict.fromkeys(
        (
            "storage_throughput_kwh", "storage_loss_kwh", "site_storage_throughput_kwh", "site_storage_loss_kwh",
            "inverter_trips", "inverter_away_s", "ups_trips", "ups_lost_kw", "ups_away_s", "ups_locked_s",
            "battery_work_kws", "battery_energy_kws", "cooling_kwh", "burnt_kwh", "held_back_kws", "moved_kws",
        ),
        "sum",
    ),
    **dict.fromkeys(("clock_mean_pct", "batch_mean", "floor_mean_pct", "pue", "burnt_pct", "moved_pct"), "mean"),
    **dict.fromkeys(("stored_lowest_pct", "site_stored_lowest_pct"), "min"),
    "ups_lost_step_kw": "max",
    **dict.fromkeys(
        (
            "stored_end_pct", "storage_missing_kwh", "site_stored_end_pct", "site_storage_missing_kwh",
            "battery_missing_kws",
        ),
        "last",
    ),
}  # fmt: skip
"""Those of the figures that devices and their features have."""

SHARE_OF = {"pue": "computing_kw", "burnt_pct": "smoothed_kw", "moved_pct": "arrived_kw"}
"""Field of the state whose sum weighs a mean: what the figure is a share of."""


class ByParts(Protocol):
    """Accumulates figures of an episode."""

    def add(self, history: Any, steps: int) -> None:
        """Take a part: the state's fields over time, (steps + 1, slot, ..) each, from the end of the part before."""
        ...

    def figures(self) -> dict[str, float]:
        """Figures of all parts so far, of which there must be one."""
        ...


class Combined:
    """Figures of parts as those of the whole."""

    def __init__(self, rules: Mapping[str, Rule] = RULES):
        self.rules = rules
        self._values: dict[str, float] = {}
        self._weights: dict[str, float] = {}

    def add(self, figures: Mapping[str, float], steps: int, weights: Mapping[str, float] | None = None) -> None:
        """Take the figures of a part; KeyError for one without a rule.

        Parameters
        ----------
        figures
            By name.
        steps
            Length of the part.
        weights
            What means are weighted by that are not by steps.
        """
        for name, value in figures.items():
            rule = self.rules[name]
            if rule == "mean":
                weight = float((weights or {}).get(name, steps))
                before = self._weights.get(name, 0.0)
                whole = before + weight
                share = weight / whole if whole else 1.0
                self._weights[name] = whole
                self._values[name] = value if not before else (1.0 - share) * self._values[name] + share * value
            elif name not in self._values or rule == "last":
                self._values[name] = value
            else:
                self._values[name] = _JOIN[rule](self._values[name], value)

    def figures(self) -> dict[str, float]:
        """Those of all parts so far."""
        return dict(self._values)


_JOIN = {"sum": lambda a, b: a + b, "min": min, "max": max}
