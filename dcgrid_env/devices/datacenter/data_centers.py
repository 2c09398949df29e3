"""Data centres of a scenario: where they stand, how large they are, and how their clock acts."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from dcgrid_env.core.cache import PickledByFields
from dcgrid_env.core.checked import FieldError, check_fields, count, number, refuse, settle
from dcgrid_env.devices.datacenter.clock_law import Dvfs, LinearDvfs, work_classes_of
from dcgrid_env.devices.datacenter.named_laws import clock_law
from dcgrid_env.devices.ratings import DataCenterParams, Rating, check_rating, per_device, read_only


@dataclass(frozen=True, kw_only=True)
class DataCenters(PickledByFields):
    """Sites alike but for their ratings. A rating is one number for all of them, or one for each."""

    kind: ClassVar[str] = "datacenter"
    prefix: ClassVar[str] = "dc"

    count: int = count(0, 10_000)
    """Number of sites."""
    buses: tuple[int | str, ...] | None = None
    """Their buses, or None: drawn in each episode among the load buses without a device."""
    p_rated_kw: Rating
    """Rated power, kW."""
    idle_share: float = number(0.0, 0.99, default=0.23)
    """Idle draw as a share of the rating."""
    f_max_mhz: float = number(1e-9, float("inf"), default=1410.0)
    """Highest clock, MHz."""
    f_min_mhz: float = number(1e-9, "f_max_mhz", default=210.0)
    """Lowest clock, MHz."""
    s_rated_share: float = number(1.0, float("inf"))
    """Converter rating as a share of the rated power."""
    q_max_share: float = number(0.0, "s_rated_share")
    """Reactive limit as a share of the rated power."""
    clock_law: Dvfs = field(default_factory=LinearDvfs)
    """How the clock turns work into speed and power: LinearDvfs(), PrefillDecodeDvfs(), or one's own. Plain form:
    "linear", "prefill-decode", or a mapping such as ``{"law": "prefill-decode", "decode_clock_share": 0.03}``."""
    boost_share: float = number(1.0, 2.0, default=1.0)
    """Highest short draw of a site as a share of its rating; up to 1.3 has been seen."""

    def __post_init__(self) -> None:
        settle(self, clock_law=_clock_law)
        check_fields(self)
        if isinstance(self.clock_law, type) or not callable(getattr(self.clock_law, "serve", None)):
            raise refuse(
                self, "clock_law", "give 'linear', 'prefill-decode', or a clock law such as PrefillDecodeDvfs()"
            )
        if hasattr(self.clock_law, "phases") and not hasattr(self.clock_law, "work_classes"):  # its older name
            raise refuse(self, "clock_law", "the law says 'phases'; name that attribute 'work_classes'")
        if work_classes_of(self.clock_law) not in (1, 2):
            wrong = work_classes_of(self.clock_law)
            raise refuse(self, "clock_law", f"give a clock law of 1 or 2 work classes, not {wrong!r}")
        check_rating(self, "p_rated_kw", self.count)

    @cached_property
    def work_classes(self) -> int:
        """Number of work classes that the clock law tells apart."""
        return work_classes_of(self.clock_law)

    @cached_property
    def parameters(self) -> DataCenterParams:
        """Ratings as arrays over the sites."""
        p = per_device(self.p_rated_kw, self.count)
        one = np.ones_like(p)
        params = DataCenterParams(
            p_rated_kw=p,
            p_idle_kw=self.idle_share * p,
            p_dynamic_kw=p - self.idle_share * p,
            f_min_mhz=self.f_min_mhz * one,
            f_max_mhz=self.f_max_mhz * one,
            s_rated_kva=self.s_rated_share * p,
            q_max_kvar=self.q_max_share * p,
        )
        return DataCenterParams(*map(read_only, params))

    @cached_property
    def q_limit_kvar(self) -> np.ndarray:
        """Reactive limit of each site at zero active power, kvar."""
        return read_only(np.minimum(self.parameters.q_max_kvar, self.parameters.s_rated_kva))

    def check_episode(self, horizon: int) -> None:
        """Nothing of a data centre depends on the length of an episode."""


def _clock_law(value: Any) -> Any:
    try:
        return clock_law(value)
    except ValueError as error:
        raise FieldError("DataCenters", "clock_law", value, str(error)) from None
