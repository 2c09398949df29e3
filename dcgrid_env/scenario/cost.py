"""Cost of a step: weights of the terms, voltage band, form and reference of the voltage cost, assignment of rewards."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from dcgrid_env.core.checked import (
    FieldError,
    as_pairs,
    as_tuples,
    choice,
    finite,
    number,
    pairs,
    refuse,
    settle,
    unknown_field,
)
from dcgrid_env.core.magnitudes import LARGEST_OF_ANY
from dcgrid_env.scenario.costs.grid_terms import TERMS

VoltageReference = Literal["nominal", "profile"]
VoltageCost = Literal["l1", "l2", "bowl", "courant_beltrami", "bump"]
RewardScope = Literal["shared", "local", "difference"]
DefaultAction = Literal["previous", "rest", "droop"]

_TARGET_RANGE_PU = (0.8, 1.2)  # in which the cost of a voltage without a solution is above that of any other
_TARGET = "give a number in [0.8, 1.2]"
_TARGETS = f"{_TARGET}, a mapping from buses or nodes to such numbers, or None"

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
    reference: VoltageReference = choice("nominal", "profile", default="nominal")
    """Reference of the voltage cost: 1 p.u., or the utility's voltage profile with a target for each node."""
    profile_pu: float | tuple[tuple[str, float], ...] | None = pairs(default=None)
    """Targets of the profile, p.u.: one number, or a mapping from buses or nodes to numbers. Targets that are not given
    are the voltages of the nominal loads with regulators settled and without devices; None for all of them."""
    profile_band_pu: float = number(0.0, 0.2, default=0.0083)
    """Half the width of the band around the profile in which no deviation is charged; 0.0083 is 1 V on a base of
    120 V."""
    reward: RewardScope = choice("shared", "local", "difference", default="shared")
    """Reward of an agent: the team's, one for its own voltage, work and effort, or the difference that its own action
    makes to the team's cost of the step."""
    default_action: DefaultAction = choice("previous", "rest", "droop", default="previous")
    """Action that a difference reward compares with. rest: all set points of t = 0. previous: the same with the
    reactive power of the step before. droop: the droop law with ``default_gains``."""
    default_gains: tuple[float, float, float] = (1.0, 0.5, 0.3)
    """Gains of the droop as the default action: k_p in MW/p.u., k_q in Mvar/(p.u. s) and alpha in 1/s."""
    ramp_limit_kw_per_s: float | None = number(1e-9, 1e9, default=None)
    """Limit on the ramp of a site's draw, kW/s, on average over ``ramp_window_s``; None for no limit."""
    ramp_window_s: float | None = number(1e-9, 1e9, default=None)
    """Averaging window of a ramp, s, a whole number of steps; None for one step."""
    voltage_step_limit_pu: float | None = number(1e-9, 1e9, default=None)
    """Limit on the change of a bus's voltage from a step to the next, p.u.; None for no limit."""

    def __post_init__(self) -> None:
        settle(self, weights=lambda value: changed_weights(CostWeights(), value), profile_pu=_targets)
        if not isinstance(self.weights, CostWeights):
            raise refuse(self, "weights", "give CostWeights(voltage=..., ...) or a mapping such as {'backlog': 0.3}")
        for name, value in self.weights._asdict().items():
            if not finite(value, 0.0, LARGEST_OF_ANY):
                raise FieldError(
                    "Cost", f"weights.{name}", value, f"give a finite number >= 0 and at most {LARGEST_OF_ANY:g}"
                )
        for term in TERMS:
            if term.limit and getattr(self.weights, term.name) and getattr(self, term.limit) is None:
                remedy = f"give {term.limit} too, which it weighs the excess over, or set it to 0"
                raise FieldError("Cost", f"weights.{term.name}", getattr(self.weights, term.name), remedy)
        if self.ramp_window_s is not None and self.ramp_limit_kw_per_s is None:
            raise refuse(self, "ramp_window_s", "give ramp_limit_kw_per_s too, or leave it out")
        self._check_default_action()
        self._check_profile()

    def _check_default_action(self) -> None:
        gains = self.default_gains
        if not isinstance(gains, tuple) or len(gains) != 3 or not all(finite(gain, 0.0, 1e9) for gain in gains):
            raise refuse(self, "default_gains", "give 3 numbers >= 0: k_p_mw_per_pu, k_q_mvar_per_pu_s, alpha_per_s")
        for name, user in (("default_action", "reward"), ("default_gains", "default_action")):
            is_given = getattr(self, name) != type(self).__dataclass_fields__[name].default
            needed = "difference" if user == "reward" else "droop"
            if is_given and getattr(self, user) != needed:
                raise refuse(self, name, f"set {user} to {needed!r}, which uses it, or leave it out")

    def _check_profile(self) -> None:
        for name in ("profile_pu", "profile_band_pu"):
            is_given = getattr(self, name) != type(self).__dataclass_fields__[name].default
            if is_given and self.reference == "nominal":
                raise refuse(self, name, "set reference to 'profile', which it belongs to, or leave it out")
        targets = self.profile_pu if isinstance(self.profile_pu, tuple) else ()
        if not all(isinstance(pair, tuple) and len(pair) == 2 and isinstance(pair[0], str) for pair in targets):
            raise refuse(self, "profile_pu", _TARGETS)
        for bus, target in targets:
            if not finite(target, *_TARGET_RANGE_PU):
                raise FieldError("Cost", f"profile_pu.{bus}", target, _TARGET)
        if not targets and self.profile_pu is not None and not finite(self.profile_pu, *_TARGET_RANGE_PU):
            raise refuse(self, "profile_pu", _TARGETS)

    @property
    def uncharged_pu(self) -> float:
        """Distance from the reference up to which the voltage cost is 0, p.u."""
        return self.profile_band_pu if self.reference == "profile" else 0.0


def _targets(value: object) -> Any:
    """Return pairs for a mapping, None for an empty one, and a float for a whole number."""
    targets = as_pairs(value)
    return None if targets == () else float(targets) if type(targets) is int else targets


def changed_weights(weights: CostWeights, changes: object) -> Any:
    """Return the weights with those that a mapping names; any other value unchanged."""
    if not isinstance(changes, Mapping):
        return changes
    for key in changes:
        if key not in CostWeights._fields:
            raise unknown_field("Cost", f"weights.{key}", CostWeights._fields)
    return weights._replace(**{key: as_tuples(value) for key, value in changes.items()})
