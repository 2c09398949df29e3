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
    ramp_excess: float = 0.0
    """Weighs the mean over sites of what their ramp exceeds ``ramp_limit_kw_per_s`` by, as a share of that limit."""
    voltage_step_excess: float = 0.0
    """Weighs the mean over buses of what their change of voltage in a step exceeds ``voltage_step_limit_pu`` by, as a
    share of that limit."""
    overload: float = 0.0
    """Weighs the mean over rated branches of what their current exceeds the rating by, as a share of it; only a feeder
    that knows ratings has it."""


LIMIT_OF = {"ramp_excess": "ramp_limit_kw_per_s", "voltage_step_excess": "voltage_step_limit_pu"}
"""The limit without which a weight has no meaning."""


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
    ramp_limit_kw_per_s: float | None = None
    """Limit on how fast a site's draw may rise or fall, kW/s, on average over ``ramp_window_s``; None for no limit."""
    ramp_window_s: float | None = None
    """What a ramp is averaged over, s, a whole number of steps; None for one step."""
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
        for name, limit in LIMIT_OF.items():
            if getattr(self.weights, name) and getattr(self, limit) is None:
                remedy = f"give {limit} too, which it weighs the excess over, or set it to 0"
                raise FieldError("Cost", f"weights.{name}", getattr(self.weights, name), remedy)
        if self.ramp_window_s is not None and self.ramp_limit_kw_per_s is None:
            raise refuse(self, "ramp_window_s", "give ramp_limit_kw_per_s too, or leave it out")


def changed_weights(weights: CostWeights, given: Any) -> Any:
    """Weights with those that a mapping names; anything else as it is."""
    if not isinstance(given, Mapping):
        return given
    for key in given:
        if key not in CostWeights._fields:
            there = ", ".join(CostWeights._fields)
            raise FieldError("Cost", f"weights.{key}", given[key], f"there is no weight {key!r}; there are {there}")
    return weights._replace(**given)
