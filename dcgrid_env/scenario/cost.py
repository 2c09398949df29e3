"""What a step costs: the weights of the terms, the band, the form of the voltage cost, and who is paid what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from dcgrid_env.core.checked import FieldError, check_fields, choice, finite, number, refuse, settle

VoltageCost = Literal["l1", "l2", "bowl", "courant_beltrami", "bump"]
RewardScope = Literal["shared", "local"]


class CostWeights(NamedTuple):
    """Weights of the cost terms (see ``reward``); a term at weight 0 is not charged and is 0 in ``info``."""

    voltage: float = 100.0
    violation: float = 1000.0
    backlog: float = 0.3
    effort: float = 0.02
    leftover: float = 9.0
    clock: float = 0.0
    step: float = 0.0
    loss: float = 0.0
    unbalance: float = 0.0
    """Weighs the mean squared voltage unbalance factor over three-phase buses, which balanced feeders do not have."""
    switching: float = 0.0
    """Weighs the mean number of taps and switchings in a step, over the regulators and capacitor banks that are not
    fixed; a three-phase feeder alone has it."""


@dataclass(frozen=True, kw_only=True)
class Cost:
    """How the cost of a step is made up."""

    weights: CostWeights = field(default_factory=CostWeights)
    """Weights; a mapping changes those that it names and leaves the others at their default."""
    band_pu: float = number(0.0, 1.0, default=0.05)
    """Half the width of the voltage band around 1 p.u."""
    voltage: VoltageCost = choice("l1", "l2", "bowl", "courant_beltrami", "bump", default="l1")
    """Form of the voltage cost."""
    reward: RewardScope = choice("shared", "local", default="shared")
    """Whether every agent is paid the team's reward, or each for its own voltage, work and effort."""

    def __post_init__(self) -> None:
        settle(self, weights=lambda given: changed_weights(CostWeights(), given))
        check_fields(self)
        if not isinstance(self.weights, CostWeights):
            raise refuse(self, "weights", "give CostWeights(voltage=..., ...) or a mapping such as {'backlog': 0.3}")
        for name, value in self.weights._asdict().items():
            if not finite(value, 0.0):
                raise FieldError("Cost", f"weights.{name}", value, "give a finite number >= 0")


def changed_weights(weights: CostWeights, given: Any) -> Any:
    """Weights with those that a mapping names; anything else as it is."""
    if not isinstance(given, Mapping):
        return given
    for key in given:
        if key not in CostWeights._fields:
            there = ", ".join(CostWeights._fields)
            raise FieldError("Cost", f"weights.{key}", given[key], f"there is no weight {key!r}; there are {there}")
    return weights._replace(**given)
