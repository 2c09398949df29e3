"""Inverters of a scenario: reactive power by command, active power by schedule."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from dcgrid_env.core.cache import PickledByFields
from dcgrid_env.core.checked import FieldError, is_number, refuse, settle
from dcgrid_env.devices.ratings import InverterParams, Rating, check_rating, per_device, read_only
from dcgrid_env.traces import SUN, PowerTrace, TraceError, is_recording, recorded_trace


@dataclass(frozen=True, kw_only=True)
class Inverters(PickledByFields):
    """Inverters alike but for their ratings. A rating is one number for all of them, or one for each."""

    kind: ClassVar[str] = "inverter"
    prefix: ClassVar[str] = "inv"

    buses: tuple[int | str, ...] = ()
    """Their buses, one each."""
    s_rated_kva: Rating = 0.0
    """Apparent-power rating, kVA."""
    injection: PowerTrace | tuple[float, ...] | str | None = None
    """Active injection of every inverter; none by default.

    "pv": generated PV under passing clouds, a window drawn in each episode, the same for all inverters. Or, from the
    episode's beginning, a recording in which 1 kW stands for the inverter's rating, or shares of the rating from -1 to
    1, one for t = 0 and one for each step (storage following a schedule; negative charges). Plain form: "pv", a list of
    shares, or a recording's name or file.
    """

    def __post_init__(self) -> None:
        settle(self, injection=_injection)
        if not isinstance(self.buses, tuple):
            raise refuse(self, "buses", "give a tuple of buses, () for none")
        check_rating(self, "s_rated_kva", self.count)
        if isinstance(self.injection, tuple):
            wrong = [share for share in self.injection if not is_number(share) or not -1 <= share <= 1]
            if wrong:
                raise FieldError(
                    "Inverters", "injection", wrong[0], "give numbers from -1 to 1, one for t = 0 and each step"
                )
        elif not (self.injection is None or self.injection == SUN):
            if not isinstance(self.injection, PowerTrace):
                remedy = f"give {SUN!r}, a PowerTrace as a share of the rating, shares for each step, or None"
                raise refuse(self, "injection", remedy)
            highest = float(np.max(self.injection.power_kw))
            if highest > 1.0:
                remedy = "it is a share of the inverter's rating; scale it, for instance trace.scaled_to(1.0)"
                raise FieldError("Inverters", "injection", f"a trace that rises to {highest:g}", remedy)

    @property
    def count(self) -> int:
        """Number of inverters."""
        return len(self.buses)

    @cached_property
    def parameters(self) -> InverterParams:
        """Ratings as arrays over the inverters."""
        return InverterParams(s_rated_kva=read_only(per_device(self.s_rated_kva, self.count)))

    @property
    def q_limit_kvar(self) -> np.ndarray:
        """Reactive limit of each inverter at zero active power, kvar."""
        return self.parameters.s_rated_kva

    def check_episode(self, horizon: int) -> None:
        """Raise FieldError unless a schedule is as long as an episode."""
        if isinstance(self.injection, tuple) and len(self.injection) < horizon + 1:
            given = f"a schedule of {len(self.injection)} shares"
            raise FieldError(
                "Inverters", "injection", given, f"give {horizon + 1} numbers from -1 to 1, for t = 0 and each step"
            )


def _injection(value: Any) -> Any:
    if not is_recording(value):
        return value
    try:
        return recorded_trace(str(value))
    except (TraceError, OSError) as error:
        raise FieldError("Inverters", "injection", str(value), str(error)) from None
