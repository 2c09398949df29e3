"""A scenario: everything that is fixed before an episode is drawn. Frozen, checked once, named fields with units."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from dcgrid_env.devices import DataCenterParams, Dvfs, InverterParams, LinearDvfs
from dcgrid_env.feeder import BusId, Feeder, FeederError
from dcgrid_env.traces import SPLITS, PowerTrace

PowerFlowName = Literal["distflow", "lindistflow"]
VoltageCost = Literal["l1", "l2", "bowl", "courant_beltrami", "bump"]
RewardScope = Literal["shared", "local"]
ObservationScope = Literal["local", "neighbours", "feeder"]


class ScenarioError(ValueError):
    """A scenario that cannot be; the message names the field, its value and what would do."""


class CostWeights(NamedTuple):
    """Weights of the cost terms (see ``reward``); those at 0 are computed and reported but not charged."""

    voltage: float = 100.0
    violation: float = 1000.0
    backlog: float = 0.3
    effort: float = 0.02
    leftover: float = 9.0
    clock: float = 0.0
    step: float = 0.0
    loss: float = 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Scenario:
    """One feeder with its devices, load, horizon and cost. Any field can be overridden where an environment is made.

    A rating is one number for all devices of a kind, or one for each.
    """

    name: str
    feeder: Feeder
    v0_pu: float
    """Substation voltage, p.u."""
    capacitors: bool = True
    """Whether the feeder's capacitors are connected."""

    n_datacenters: int
    datacenter_buses: tuple[BusId, ...] | None = None
    """Their buses, or None: drawn in each episode among the load buses without a device."""
    p_rated_kw: float | tuple[float, ...]
    idle_share: float = 0.23
    """Idle draw as a share of the rating."""
    f_min_mhz: float = 210.0
    f_max_mhz: float = 1410.0
    s_rated_share: float
    """Converter rating as a share of the rated power."""
    q_max_share: float
    """Reactive limit as a share of the rated power."""
    dvfs: Dvfs = field(default_factory=LinearDvfs)

    inverter_buses: tuple[BusId, ...] = ()
    inverter_s_kva: float | tuple[float, ...] = 0.0
    inverter_trace: PowerTrace | None = None
    """Active injection from the episode's beginning as a share of the inverter's rating; none by default."""

    trace: str | tuple[PowerTrace, ...] = "inference"
    """Source of the data centres' load: a name (``dcgrid list``) or recordings, each scaled to the site's rating."""
    trace_window: Literal["random", "start"] = "random"
    """Where in a trace an episode begins."""
    load_sigma: float = 0.05
    """Standard deviation of the other loads' noise as a share of the load."""
    load_rho: float = 0.9
    """Its correlation over one second."""
    voltage_noise_pu: float = 0.0
    """Standard deviation of the voltage measurement, p.u."""
    measurement_delay: int = 0
    """Age of the measured voltage, steps."""

    horizon: int = 120
    """Actions in an episode."""
    dt_s: float = 1.0
    power_flow: PowerFlowName = "distflow"
    split: str = "train"
    weights: CostWeights = field(default_factory=CostWeights)
    band_pu: float = 0.05
    voltage_cost: VoltageCost = "l1"
    reward: RewardScope = "shared"
    observe: ObservationScope = "local"
    preview: bool = True
    """Whether a data centre observes its p_ref over the coming interval."""

    def __post_init__(self) -> None:
        _check(self)

    def __deepcopy__(self, memo: dict[int, Any]) -> Scenario:
        return self  # frozen: a copy of an environment shares it

    def replace(self, **overrides: Any) -> Scenario:
        """A scenario with other values in the named fields; ScenarioError for a name that is none, listing them."""
        known = [f.name for f in dataclasses.fields(self)]
        for key in overrides:
            if key not in known:
                raise ScenarioError(f"scenario {self.name!r} has no field {key!r}; there are {', '.join(known)}")
        return dataclasses.replace(self, **overrides)

    @property
    def n_inverters(self) -> int:
        """Number of inverters."""
        return len(self.inverter_buses)

    @cached_property
    def agents(self) -> tuple[str, ...]:
        """Agent ids, slots that are the same in every episode: dc_0.., then inv_0.."""
        return (*(f"dc_{i}" for i in range(self.n_datacenters)), *(f"inv_{i}" for i in range(self.n_inverters)))

    @property
    def n_agents(self) -> int:
        """Number of agents, data centres first."""
        return self.n_datacenters + self.n_inverters

    @cached_property
    def datacenter(self) -> DataCenterParams:
        """Ratings of the data centres."""
        p = _per_device(self.p_rated_kw, self.n_datacenters)
        one = np.ones_like(p)
        return DataCenterParams(
            p_rated_kw=p,
            p_idle_kw=self.idle_share * p,
            p_dynamic_kw=p - self.idle_share * p,
            f_min_mhz=self.f_min_mhz * one,
            f_max_mhz=self.f_max_mhz * one,
            s_rated_kva=self.s_rated_share * p,
            q_max_kvar=self.q_max_share * p,
        )

    @cached_property
    def inverter(self) -> InverterParams:
        """Ratings of the inverters."""
        return InverterParams(s_rated_kva=_per_device(self.inverter_s_kva, self.n_inverters))

    @cached_property
    def candidates(self) -> np.ndarray:
        """Positions in ``bus_ids`` where a data centre may be drawn: load buses without an inverter."""
        taken = {0, *(self.feeder.index(b) for b in self.inverter_buses)}
        return np.array([i for i in np.flatnonzero(self.feeder.p_load_kw > 0) if i not in taken], dtype=np.int64)


def _per_device(value: float | tuple[float, ...], n: int) -> np.ndarray:
    return np.array(value, dtype=np.float64) if isinstance(value, tuple) else np.full(n, float(value))


def _check(s: Scenario) -> None:
    def refuse(field_name: str, wanted: str) -> None:
        raise ScenarioError(f"scenario {s.name!r}: {field_name} is {getattr(s, field_name)!r}; {wanted}")

    if not isinstance(s.feeder, Feeder):
        refuse("feeder", "give a Feeder (load_feeder(name) or Feeder.from_csv(folder))")
    for name, low, high in (
        ("v0_pu", 0.5, 1.5),
        ("idle_share", 0.0, 0.99),
        ("s_rated_share", 1.0, math.inf),
        ("q_max_share", 0.0, s.s_rated_share),
        ("f_min_mhz", 1e-9, s.f_max_mhz),
        ("f_max_mhz", 1e-9, math.inf),
        ("load_sigma", 0.0, 0.3),
        ("load_rho", 0.0, 1.0 - 1e-9),
        ("voltage_noise_pu", 0.0, 1.0),
        ("dt_s", 1e-3, 3600.0),
        ("band_pu", 0.0, 1.0),
    ):
        value = getattr(s, name)
        if not isinstance(value, int | float) or not low <= value <= high or math.isinf(value):
            refuse(name, f"give a finite number in [{low:g}, {high:g}]")
    for name, low in (("n_datacenters", 0), ("horizon", 1), ("measurement_delay", 0)):
        value = getattr(s, name)
        if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < low:
            refuse(name, f"give a whole number of at least {low}")
    for name, choices in (
        ("power_flow", get_args(PowerFlowName)),
        ("voltage_cost", get_args(VoltageCost)),
        ("reward", get_args(RewardScope)),
        ("observe", get_args(ObservationScope)),
        ("trace_window", ("random", "start")),
        ("split", SPLITS),
    ):
        if getattr(s, name) not in choices:
            refuse(name, f"choose one of {', '.join(choices)}")
    for name, value in s.weights._asdict().items():
        if not (isinstance(value, int | float) and math.isfinite(value) and value >= 0):
            raise ScenarioError(f"scenario {s.name!r}: weights.{name} is {value!r}; give a finite number >= 0")
    for name, n in (("p_rated_kw", s.n_datacenters), ("inverter_s_kva", s.n_inverters)):
        values = _per_device(getattr(s, name), n)
        if values.shape != (n,) or not (np.isfinite(values).all() and (values > 0).all()):
            refuse(name, f"give one positive number, or one for each of the {n} devices")
    _check_placement(s)


def _check_placement(s: Scenario) -> None:
    fixed = list(s.inverter_buses)
    if s.datacenter_buses is not None:
        if len(s.datacenter_buses) != s.n_datacenters:
            raise ScenarioError(
                f"scenario {s.name!r}: {len(s.datacenter_buses)} datacenter_buses for n_datacenters = {s.n_datacenters}"
            )
        fixed += s.datacenter_buses
    for bus in fixed:
        try:
            at = s.feeder.index(bus)
        except FeederError as error:
            raise ScenarioError(f"scenario {s.name!r}: {error}") from None
        if at == 0:
            raise ScenarioError(f"scenario {s.name!r}: a device at the substation {bus!r}; its voltage is held")
        if fixed.count(bus) > 1:
            raise ScenarioError(f"scenario {s.name!r}: more than one device at bus {bus!r}; give each its own")
    if s.datacenter_buses is None and s.n_datacenters > len(s.candidates):
        raise ScenarioError(
            f"scenario {s.name!r}: n_datacenters is {s.n_datacenters}, but only {len(s.candidates)} load buses "
            "have no device"
        )
    if s.n_agents == 0:
        raise ScenarioError(f"scenario {s.name!r}: no data centre and no inverter, hence no agent")
