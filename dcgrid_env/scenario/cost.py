"""Cost of a step: weights of the terms, voltage band, form of the voltage cost, and assignment of rewards."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from dcgrid_env.core.checked import (
    FieldError,
    UnknownFieldError,
    as_plain,
    check_fields,
    choice,
    finite,
    number,
    refuse,
    settle,
)
from dcgrid_env.scenario.costs.grid_terms import TERMS

VoltageCost = Literal["l1", "l2", "bowl", "courant_beltrami", "bump"]
RewardScope = Literal["shared", "local"]


_BY_DEFAULT_FIRST = sorted(TERMS, key=lambda term: term.weight == 0.0)
_Weights: Any = namedtuple(
    "CostWeights", [term.name for term in _BY_DEFAULT_FIRST], defaults=[term.weight for term in _BY_DEFAULT_FIRST]
)


class CostWeights(_Weights):
    """Weights of the cost terms. A term at weight 0 is not charged and is 0 in ``info``."""

    __slots__ = ()
    __doc__ = "\n".join(
        (
            f"{__doc__}\n",
            *(f"- ``{term.name}``, by default {term.weight:g}: {term.meaning}" for term in _BY_DEFAULT_FIRST),
        )
    )

    @property
    def unmodelled(self) -> tuple[str, ...]:
        """Terms that have a weight, but that controllers with a model of the cost do not account for."""
        return tuple(term.name for term in TERMS if not term.is_modelled and getattr(self, term.name))


@dataclass(frozen=True, kw_only=True)
class Cost:
    """Settings of a step's cost."""

    weights: CostWeights = field(default_factory=CostWeights)
    """Weights of the cost terms; a mapping changes those that it names, and the others keep their default."""
    band_pu: float = number(0.0, 1.0, default=0.05)
    """Half the width of the voltage band around 1 p.u."""
    voltage: VoltageCost = choice("l1", "l2", "bowl", "courant_beltrami", "bump", default="l1")
    """Form of the voltage cost."""
    reward: RewardScope = choice("shared", "local", default="shared")
    """Reward of an agent: the team's, or one for its own voltage, work and effort."""
    ramp_limit_kw_per_s: float | None = None
    """Limit on the ramp of a site's draw, kW/s, on average over ``ramp_window_s``; None for no limit."""
    ramp_window_s: float | None = None
    """Averaging window of a ramp, s, a whole number of steps; None for one step."""
    voltage_step_limit_pu: float | None = None
    """Limit on the change of a bus's voltage from a step to the next, p.u.; None for no limit."""

    def __post_init__(self) -> None:
        settle(self, weights=lambda given: changed_weights(CostWeights(), given))
        check_fields(self)
        if not isinstance(self.weights, CostWeights):
            raise refuse(self, "weights", "give CostWeights(voltage=..., ...) or a mapping such as {'backlog': 0.3}")
        for name, value in self.weights._asdict().items():
            if not finite(value, 0.0):
                raise FieldError("Cost", f"weights.{name}", value, "give a finite number >= 0")
        for name in ("ramp_limit_kw_per_s", "ramp_window_s", "voltage_step_limit_pu"):
            value = getattr(self, name)
            if value is not None and not finite(value, 1e-9, 1e9):
                raise refuse(self, name, "give a finite number above 0, or None")
        for term in TERMS:
            if term.limit and getattr(self.weights, term.name) and getattr(self, term.limit) is None:
                remedy = f"give {term.limit} too, which it weighs the excess over, or set it to 0"
                raise FieldError("Cost", f"weights.{term.name}", getattr(self.weights, term.name), remedy)
        if self.ramp_window_s is not None and self.ramp_limit_kw_per_s is None:
            raise refuse(self, "ramp_window_s", "give ramp_limit_kw_per_s too, or leave it out")


def changed_weights(weights: CostWeights, given: object) -> Any:
    """Return the weights with those that a mapping names; any other value unchanged."""
    if not isinstance(given, Mapping):
        return given
    for key in given:
        if key not in CostWeights._fields:
            raise UnknownFieldError("Cost", f"weights.{key}", given[key], CostWeights._fields)
    return weights._replace(**{key: as_plain(value) for key, value in given.items()})
