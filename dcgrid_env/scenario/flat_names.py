"""A scenario's fields by one name each, without the part that they stand in: ``scenario.band_pu`` is ``cost.band_pu``.

These are the names that overrides take on the command line and in ``gymnasium.make``, beside those of the parts.
"""

from __future__ import annotations

from typing import Any, Generic, Literal, TypeVar

from dcgrid_env.devices import Dvfs
from dcgrid_env.devices.capacitor_bank.capacitor_control import CapacitorControl
from dcgrid_env.devices.datacenter.batching import Batching
from dcgrid_env.devices.datacenter.cooled_site import Cooling
from dcgrid_env.devices.datacenter.power_smoothing import PowerSmoothing
from dcgrid_env.devices.datacenter.service_levels import ServiceLevels
from dcgrid_env.devices.datacenter.site_storage import SiteStorage
from dcgrid_env.devices.datacenter.work_routing import Routing
from dcgrid_env.devices.phases import Phases
from dcgrid_env.devices.ratings import Rating
from dcgrid_env.devices.ride_through.rules import RideThrough, UpsRideThrough
from dcgrid_env.scenario.cost import CostWeights, RewardScope, VoltageCost
from dcgrid_env.scenario.grid_control import ByBank, Decider
from dcgrid_env.scenario.sensing import ObservationScope
from dcgrid_env.scenario.workload import RecordingSplit, TraceScale, TraceWindow
from dcgrid_env.traces import PowerTrace

Value = TypeVar("Value")

FLAT: dict[str, tuple[str, str]] = {}
"""Part and field behind each name; the part is "" for a field of the scenario itself, or a kind of device."""
Buses = tuple[int | str, ...]


class Flat(Generic[Value]):
    """A field of a part, read from the scenario; looked up once, and then the scenario's own."""

    def __init__(self, part: str, field: str):
        self.part, self.field = part, field

    def __set_name__(self, owner: type[Any], name: str) -> None:
        self.name = name
        FLAT[name] = (self.part, self.field)

    def __get__(self, scenario: Any, owner: type[Any] | None = None) -> Value:
        if scenario is None:
            return self  # pyright: ignore[reportReturnType] (the descriptor itself, on the class)
        value = getattr(scenario.part(self.part), self.field)
        scenario.__dict__[self.name] = value
        return value


class FlatNames:
    """Mixed into Scenario. What each means stands at the field of the part."""

    v0_pu = Flat[float]("", "source_voltage_pu")

    n_datacenters = Flat[int]("datacenter", "count")
    datacenter_buses = Flat[Buses | None]("datacenter", "buses")
    p_rated_kw = Flat[Rating]("datacenter", "p_rated_kw")
    idle_share = Flat[float]("datacenter", "idle_share")
    f_min_mhz = Flat[float]("datacenter", "f_min_mhz")
    f_max_mhz = Flat[float]("datacenter", "f_max_mhz")
    s_rated_share = Flat[float]("datacenter", "s_rated_share")
    q_max_share = Flat[float]("datacenter", "q_max_share")
    dvfs = Flat[Dvfs]("datacenter", "clock_law")
    boost_share = Flat[float]("datacenter", "boost_share")
    datacenter_phases = Flat[Phases | None]("datacenter", "phases")
    datacenter_ride_through = Flat[UpsRideThrough | None]("datacenter", "ride_through")
    datacenter_smoothing = Flat[PowerSmoothing | None]("datacenter", "smoothing")
    datacenter_cooling = Flat[Cooling | None]("datacenter", "cooling")
    datacenter_routing = Flat[Routing | None]("datacenter", "routing")
    datacenter_batching = Flat[Batching | None]("datacenter", "batching")
    datacenter_service = Flat[ServiceLevels | None]("datacenter", "service")
    datacenter_storage = Flat[SiteStorage | None]("datacenter", "storage")

    inverter_buses = Flat[Buses]("inverter", "buses")
    inverter_s_kva = Flat[Rating]("inverter", "s_rated_kva")
    inverter_phases = Flat[Phases | None]("inverter", "phases")
    inverter_ride_through = Flat[RideThrough | None]("inverter", "ride_through")
    inverter_trace = Flat[PowerTrace | tuple[float, ...] | str | None]("inverter", "injection")

    trace = Flat[str | tuple[PowerTrace, ...]]("workload", "trace")
    trace_scale = Flat[TraceScale]("workload", "trace_scale")
    recording_split = Flat[RecordingSplit]("workload", "recording_split")
    trace_window = Flat[TraceWindow]("workload", "window")
    site_correlation = Flat[float]("workload", "site_correlation")
    compute_share = Flat[float]("workload", "compute_share")
    full_load_s = Flat[tuple[float, float] | None]("workload", "full_load_s")

    capacitors = Flat[bool]("background", "capacitors")
    load_sigma = Flat[float]("background", "load_sigma")
    load_rho = Flat[float]("background", "load_rho")
    start_hour = Flat[float | Literal["random"] | None]("background", "start_hour")

    voltage_noise_pu = Flat[float]("sensing", "noise_pu")
    measurement_delay = Flat[int]("sensing", "delay_steps")
    observe = Flat[ObservationScope]("sensing", "observe")
    preview = Flat[bool]("sensing", "preview")
    observe_loading = Flat[bool]("sensing", "loading")
    r_model_share = Flat[float]("sensing", "r_model_share")
    x_model_share = Flat[float]("sensing", "x_model_share")

    regulators = Flat[Decider | ByBank]("grid_control", "regulators")
    capacitor_banks = Flat[Decider | ByBank]("grid_control", "capacitors")
    capacitor_settings = Flat[CapacitorControl]("grid_control", "capacitor_settings")

    weights = Flat[CostWeights]("cost", "weights")
    band_pu = Flat[float]("cost", "band_pu")
    voltage_cost = Flat[VoltageCost]("cost", "voltage")
    reward = Flat[RewardScope]("cost", "reward")
    ramp_limit_kw_per_s = Flat[float | None]("cost", "ramp_limit_kw_per_s")
    ramp_window_s = Flat[float | None]("cost", "ramp_window_s")
    voltage_step_limit_pu = Flat[float | None]("cost", "voltage_step_limit_pu")
