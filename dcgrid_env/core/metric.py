"""Metrics of an episode: their names, their look in tables, and the rules that combine values of parts.

A metric is declared once, next to the function that computes it. ``engine.cost.metric_list`` collects the records.
Tables, streaming and the documentation are derived from them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

Rule = Literal["sum", "mean", "min", "max", "last"]
"""Rule that combines the values of parts. A mean is weighted, by the number of steps unless otherwise stated."""
Table = Literal["run", "evaluate", "benchmark", "check"]
"""Commands whose tables choose among the metrics."""


@dataclass(frozen=True)
class Metric:
    """A metric: its name, its unit, its look in tables, and the rules that combine its values."""

    name: str
    """Its name in records, with the unit of its value."""
    label: str
    """Its name in tables."""
    unit: str
    """Unit of the value in tables; empty for a number without one."""
    decimals: int
    """Digits after the point in tables."""
    better: Literal["lower", "higher", "neither"]
    """Which of two values is preferable, all else equal."""
    meaning: str = ""
    """Explanation; the label says all if it is empty."""
    over_parts: Rule | None = None
    """Rule that combines the values of an episode's parts; None if an accumulator is needed."""
    share_of: str = ""
    """Field of the device's state whose sum weights a mean over parts; the number of steps if it is empty."""
    over_episodes: Literal["mean", "min", "max"] = "mean"
    """Rule that combines the values of several episodes."""
    tables: tuple[Table, ...] = ()
    """Tables that show it."""
    short: str = ""
    """Heading in narrow tables, with the unit; the heading of other tables if it is empty."""
    scale: float = 1.0
    """Factor of the value in tables."""

    @property
    def heading(self) -> str:
        """Label and unit."""
        return f"{self.label}, {self.unit}" if self.unit else self.label

    @property
    def column(self) -> str:
        """Heading in narrow tables."""
        return self.short or self.heading

    def is_worse(self, means: Mapping[str, float], others: Mapping[str, float]) -> bool:
        """Whether it is worse in the first of two records, by the digits in tables."""
        mean, other = (round(self.scale * record[self.name], self.decimals) for record in (means, others))
        return {"lower": mean > other, "higher": mean < other, "neither": False}[self.better]

    def text(self, value: float) -> str:
        """The value as tables show it, without its unit."""
        return f"{self.scale * value:.{self.decimals}f}"

    def of_episodes(self, values: Iterable[float]) -> float:
        """One value of those of several episodes, of which there must be one."""
        found = list(values)
        return sum(found) / len(found) if self.over_episodes == "mean" else _JOIN[self.over_episodes](found)


def cost_metric(term: str, label: str, tables: tuple[Table, ...] = ()) -> Metric:
    """The metric of a term of the cost: its sum over the steps, divided by T."""
    meaning = f"the term ``{term}`` of the cost, summed over the steps and divided by T"
    return Metric(f"cost_{term}", label, "", 4, "lower", meaning, "sum", tables=tables)


class Streaming(Protocol):
    """Accumulates the metrics of a device over an episode that comes in parts."""

    def add(self, history: Any, steps: int) -> None:
        """Take a part: the state's fields over time, (steps + 1, slot, ..) each, from the end of the part before."""
        ...

    def figures(self) -> dict[str, float]:
        """Metrics of all parts so far, of which there must be one."""
        ...


class Combined:
    """Metrics of parts as those of the whole, by the rules of their records."""

    def __init__(self, metrics: Iterable[Metric]):
        self._rules = {metric.name: metric.over_parts for metric in metrics if metric.over_parts}
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
            Weights of means that are not weighted by steps.
        """
        for name, value in figures.items():
            rule = self._rules[name]
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
                self._values[name] = _JOIN[rule]((self._values[name], value))

    def figures(self) -> dict[str, float]:
        """Those of all parts so far."""
        return dict(self._values)


_JOIN: dict[str, Callable[[Any], float]] = {"sum": sum, "min": min, "max": max}
