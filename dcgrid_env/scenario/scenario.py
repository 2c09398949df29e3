"""A scenario: everything that is fixed before an episode is drawn. Frozen, checked once, named fields with units."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np

from dcgrid_env.core.cache import fields_alone
from dcgrid_env.devices import DataCenterParams, Dvfs, InverterParams, LinearDvfs, work_classes_of
from dcgrid_env.devices.faults import KINDS, Fault
from dcgrid_env.grid import BusId, Feeder
from dcgrid_env.scenario.field_checks import (
    CostWeights,
    ObservationScope,
    PowerFlowName,
    RecordingSplit,
    RewardScope,
    ScenarioError,
    TraceWindow,
    VoltageCost,
    check,
)
from dcgrid_env.scenario.plain import from_plain
from dcgrid_env.traces import PowerTrace

__all__ = ["CostWeights", "Scenario", "ScenarioError"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Scenario:
    """One feeder with its devices, load, horizon and cost. Any field can be overridden where an environment is made.

    A rating is one number for all devices of a kind, or one for each. Every field also takes plain data, as JSON or
    YAML hold it: see ``plain_data``.
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
    """Clock law: LinearDvfs() or PrefillDecodeDvfs(), or one's own."""
    boost_share: float = 1.0
    """Highest short draw of a site as a share of its rating; up to 1.3 has been seen."""

    inverter_buses: tuple[BusId, ...] = ()
    inverter_s_kva: float | tuple[float, ...] = 0.0
    inverter_trace: PowerTrace | tuple[float, ...] | str | None = None
    """Active injection of every inverter; none by default.

    "pv": generated PV under passing clouds, a window drawn in each episode, the same for all inverters. Or, from the
    episode's beginning, a recording in which 1 kW stands for the inverter's rating, or shares of the rating from -1 to
    1, one for t = 0 and one for each step (storage following a schedule; negative charges).
    """
    faults: tuple[Fault, ...] = ()
    """Devices lost in an episode, see :class:`Fault`."""

    trace: str | tuple[PowerTrace, ...] = "inference"
    """Source of the data centres' load: a name (``dcgrid list``) or recordings, each scaled to the site's rating.

    The first 60 % of a recording are for training, then 20 % for validation and 20 % for test, and each part must be as
    long as an episode."""
    recording_split: RecordingSplit = "time"
    """Whether each recording is cut in time, or whole recordings go to the splits in these shares."""
    trace_window: TraceWindow = "random"
    """Where in a trace an episode begins: anywhere for each site, at its start, or anywhere but at the same time for
    all sites of an episode (``together``: what was recorded or generated side by side stays so)."""
    site_correlation: float = 0.0
    """Probability that a site draws what the first one does, the same row and time; 1 for all sites in step."""
    compute_share: float = 1.0
    """Compute-bound share of the work where the trace does not tell (recordings), for a law of two work classes."""
    load_sigma: float = 0.05
    """Standard deviation of the other loads' noise as a share of the load."""
    load_rho: float = 0.9
    """Its correlation over one second."""
    voltage_noise_pu: float = 0.0
    """Standard deviation of the voltage measurement, p.u."""
    measurement_delay: int = 0
    """Age of the measured voltage, steps."""

    start_hour: float | Literal["random"] | None = None
    """Time of day at which an episode begins, h in [0, 24), or "random": drawn in each episode. Base load, generated PV
    and generated requests then follow the course of a day (``traces.day_course``). None: "random" for an episode longer
    than an hour; a shorter one stands still at the feeder's nominal load and at noon."""
    horizon: int = 120
    """Actions in an episode."""
    dt_s: float = 1.0
    power_flow: PowerFlowName = "distflow"
    split: str = "train"
    """train, validation and test share no episode; ood is out of distribution, another GPU or service (generators)."""
    weights: CostWeights = field(default_factory=CostWeights)
    band_pu: float = 0.05
    voltage_cost: VoltageCost = "l1"
    reward: RewardScope = "shared"
    observe: ObservationScope = "local"
    preview: bool = True
    """Whether a data centre observes its p_ref over the coming interval."""
    r_model_share: float = 1.0
    """Resistance of every branch as agents and controllers believe it, as a share of the true one."""
    x_model_share: float = 1.0
    """The same of the reactance."""

    def __post_init__(self) -> None:
        for f in dataclasses.fields(self):
            given = getattr(self, f.name)
            found = from_plain(f.name, given, CostWeights())
            if found is not given:
                object.__setattr__(self, f.name, found)
        check(self)

    def __getstate__(self) -> dict[str, Any]:
        return fields_alone(self)

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, value)

    def __deepcopy__(self, memo: dict[int, Any]) -> Scenario:
        return self  # frozen: a copy of an environment shares it

    def replace(self, **overrides: Any) -> Scenario:
        """A scenario with other values in the named fields, objects or plain data.

        A mapping of weights changes those that it names and leaves the others.

        Raises
        ------
        TypeError
            For a name that is no field, listing the fields; in the words that Python has for it, by which clients that
            try out arguments know it.
        ScenarioError
            For a value that cannot be.
        """
        known = [f.name for f in dataclasses.fields(self)]
        for key in overrides:
            if key not in known:
                raise TypeError(
                    f"scenario {self.name!r} got an unexpected keyword argument {key!r}; its fields are "
                    f"{', '.join(known)}"
                )
        if isinstance(overrides.get("weights"), Mapping):
            overrides = overrides | {"weights": from_plain("weights", overrides["weights"], self.weights)}
        return dataclasses.replace(self, **overrides)

    def difference(self, other: Scenario) -> str | None:
        """Name of the first field in which two scenarios differ, None if there is none."""
        for f in dataclasses.fields(self):
            if not _alike(getattr(self, f.name), getattr(other, f.name)):
                return f.name
        return None

    @cached_property
    def follows_day(self) -> bool:
        """Whether base load, generated PV and generated requests follow the course of a day."""
        return self.start_hour is not None or self.horizon * self.dt_s > 3600.0

    @property
    def n_inverters(self) -> int:
        """Number of inverters."""
        return len(self.inverter_buses)

    @cached_property
    def agents(self) -> tuple[str, ...]:
        """Agent ids, slots that are the same in every episode: dc_0.., then inv_0.."""
        return (*(f"dc_{i}" for i in range(self.n_datacenters)), *(f"inv_{i}" for i in range(self.n_inverters)))

    @cached_property
    def work_classes(self) -> int:
        """Number of work classes that the clock law tells apart."""
        return work_classes_of(self.dvfs)

    @property
    def n_agents(self) -> int:
        """Number of agents, data centres first."""
        return self.n_datacenters + self.n_inverters

    @cached_property
    def model(self) -> Feeder:
        """The feeder as agents and controllers know it; the power flow is that of ``feeder``."""
        if self.r_model_share == 1.0 and self.x_model_share == 1.0:
            return self.feeder
        r_ohm, x_ohm = self.r_model_share * self.feeder.r_ohm, self.x_model_share * self.feeder.x_ohm
        return dataclasses.replace(self.feeder, r_ohm=r_ohm, x_ohm=x_ohm)

    @cached_property
    def datacenter(self) -> DataCenterParams:
        """Ratings of the data centres."""
        p = _per_device(self.p_rated_kw, self.n_datacenters)
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
        return DataCenterParams(*map(_read_only, params))

    @cached_property
    def inverter(self) -> InverterParams:
        """Ratings of the inverters."""
        return InverterParams(s_rated_kva=_read_only(_per_device(self.inverter_s_kva, self.n_inverters)))

    @cached_property
    def q_scale_kvar(self) -> np.ndarray:
        """Reactive limit of each agent at zero active power, kvar, (n_agent,): what a reactive action is a share of."""
        dc = self.datacenter
        return _read_only(np.concatenate((np.minimum(dc.q_max_kvar, dc.s_rated_kva), self.inverter.s_rated_kva)))

    @cached_property
    def fault_targets(self) -> tuple[np.ndarray, ...]:
        """What each fault draws from: an agent's position, or n_agents + the position of a capacitor's bus."""
        found = []
        for fault in self.faults:
            targets: list[int] = []
            for name in fault.among:
                if name in KINDS:
                    targets += self._of_kind(name)
                else:
                    targets.append(self.agents.index(name))
            found.append(np.unique(targets))
        return tuple(map(_read_only, found))

    def _of_kind(self, kind: str) -> list[int]:
        if kind == "datacenter":
            return list(range(self.n_datacenters))
        if kind == "inverter":
            return list(range(self.n_datacenters, self.n_agents))
        connected = self.feeder.capacitor_kvar > 0 if self.capacitors else np.zeros(self.feeder.n_bus, bool)
        return [self.n_agents + int(bus) for bus in np.flatnonzero(connected)]

    @cached_property
    def candidates(self) -> np.ndarray:
        """Positions in ``bus_ids`` where a data centre may be drawn: load buses without an inverter."""
        taken = {0, *(self.feeder.index(b) for b in self.inverter_buses)}
        free = [i for i in np.flatnonzero(self.feeder.p_load_kw > 0) if i not in taken]
        return _read_only(np.array(free, dtype=np.int64))


def _read_only(array: np.ndarray) -> np.ndarray:
    """Controllers are handed the scenario; what they do to it must not change the physics."""
    array.setflags(write=False)
    return array


def _per_device(value: float | tuple[float, ...], n: int) -> np.ndarray:
    return np.array(value, dtype=np.float64) if isinstance(value, tuple) else np.full(n, float(value))


def _alike(a: Any, b: Any) -> bool:
    """Equality that looks into arrays, and into feeders and traces, which compare by identity."""
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(_alike, a, b))
    if dataclasses.is_dataclass(a):
        return all(_alike(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    return a == b
