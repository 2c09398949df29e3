"""Fingerprint of a scenario, which links published figures to the same scenario.

Schema 1 lists its contents: for each kind of object, the name and the fields, in this order, each by value. A field
that is in no list was added later. It is left out at its default, so a new field with a default does not change
fingerprints. ``grid_control.regulator_settings``, whose default has changed, is left out on balanced feeders only.
These lists never change: other lists need a new schema number, and published figures must then be regenerated.

Buses are identified by text. If the text of every bus of a feeder is a whole number, its buses are hashed as numbers,
else as text.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from dataclasses import MISSING
from itertools import chain
from operator import attrgetter
from typing import Any

from dcgrid_env.core.digest import digest
from dcgrid_env.devices import DataCenters, Inverters, PowerCapDvfs, PrefillDecodeDvfs, Storages
from dcgrid_env.devices.datacenter.batching import Batching
from dcgrid_env.devices.datacenter.cooled_site import Cooling
from dcgrid_env.devices.datacenter.power_smoothing import PowerSmoothing
from dcgrid_env.devices.datacenter.service_levels import ServiceLevels
from dcgrid_env.devices.datacenter.site_storage import SiteStorage
from dcgrid_env.devices.datacenter.work_routing import Routing
from dcgrid_env.devices.faults import Fault
from dcgrid_env.devices.ride_through.rules import RideThrough, UpsRideThrough
from dcgrid_env.devices.ride_through.sags import Sag
from dcgrid_env.devices.ride_through.voltage_curve import RideThroughCurve
from dcgrid_env.devices.tap_changer.regulator_control import RegulatorControl
from dcgrid_env.grid import Feeder, ThreePhaseFeeder, bus_numbers
from dcgrid_env.grid.network import (
    CapacitorTable,
    LineTable,
    Network,
    NodeTable,
    PhaseLineTable,
    PhaseLoadTable,
    RegulatorTable,
    ShuntTable,
    SwitchTable,
    TransformerTable,
)
from dcgrid_env.scenario.assembly import ALIASES, FORMER, GROUPS, PARTS
from dcgrid_env.scenario.cost import CostWeights
from dcgrid_env.scenario.grid_request import LoadTarget
from dcgrid_env.scenario.scenario import Scenario
from dcgrid_env.traces import ProfileTable

SCHEMA_1: dict[type[Any], str] = {
    Scenario: """
        name feeder v0_pu capacitors n_datacenters datacenter_buses p_rated_kw idle_share f_min_mhz f_max_mhz
        s_rated_share q_max_share dvfs boost_share inverter_buses inverter_s_kva inverter_trace faults trace
        recording_split trace_window site_correlation compute_share load_sigma load_rho voltage_noise_pu
        measurement_delay start_hour? horizon dt_s power_flow split weights band_pu voltage_cost reward observe
        preview r_model_share x_model_share
    """,
    Feeder: "name base_kv v0_pu bus_ids p_load_kw q_load_kvar capacitor_kvar parent r_ohm x_ohm x y",
    CostWeights: "voltage violation backlog effort leftover clock step loss",
    Fault: "among begin_s duration_s",
    DataCenters: """
        count buses p_rated_kw idle_share f_max_mhz f_min_mhz s_rated_share q_max_share clock_law boost_share phases
    """,
    Inverters: "buses s_rated_kva injection phases",
    Storages: """
        buses p_rated_kw energy_kwh charge_efficiency discharge_efficiency standby_share_per_h s_rated_kva
        initial_share returned_share ageing_price missing_price phases
    """,
    RideThroughCurve: "under over",
    RideThrough: "curve return_delay_s walk_in_s trip_weight",
    UpsRideThrough: """
        curve return_delay_s walk_in_s trip_weight lockout_events lockout_window_s returns_per_minute release
        by_hand_s stagger_s on_battery battery_s recharge_share charge_efficiency away_weight missing_weight
    """,
    Sag: "begin_s duration_s retained_pu since",
    PowerSmoothing: """
        floor_share ramp_up_w_per_s ramp_down_w_per_s hysteresis_s gpus gpu_rated_w control change_every_s
        slowest_share burnt_weight
    """,
    Cooling: "cooling_share time_constant_s auxiliary_share",
    SiteStorage: """
        p_rated_kw energy_kwh charge_efficiency discharge_efficiency standby_share_per_h initial_share returned_share
        ageing_price missing_price
    """,
    Routing: "movable_share move_latency_s move_weight",
    Batching: "lowest highest reference batch_energy_share gather_s batch_weight",
    ServiceLevels: "target_s deadline_s interactive_share order late_weight",
    Network: """
        name source node line load shunt phase_line switch transformer regulator phase_load capacitor frequency_hz
        source_of_facts
    """,
    NodeTable: "bus phase x y base_kv_ln",
    LineTable: "from_bus to_bus r_ohm x_ohm",
    ShuntTable: "bus phase capacitor_kvar",
    PhaseLineTable: "name from_bus to_bus phases length_m r_ohm x_ohm b_us",
    SwitchTable: "name from_bus to_bus phases state r_ohm x_ohm",
    TransformerTable: """
        name from_bus to_bus phases connection_from connection_to kva kv_ll_from kv_ll_to r_percent x_percent
        shift_deg antifloat_ppm
    """,
    RegulatorTable: """
        name bank from_bus to_bus phases sensed_phase kv_ln kva_per_phase r_percent x_percent tap tap_neutral tap_min
        tap_max tap_step vreg_v band_v pt_ratio ct_primary_a r_ldc_v x_ldc_v delay_s tap_delay_s max_taps_per_move
        antifloat_ppm
    """,
    PhaseLoadTable: "name bus connection model leg_kv p_kw q_kvar vmin_pu vmax_pu vlow_pu zip",
    CapacitorTable: "name bus connection leg_kv kvar state",
    RegulatorControl: "timer offset_v hold_s",
    LoadTarget: "kind value_share value_mw begin_s ramp_s duration_s priority",
    PrefillDecodeDvfs: "decode_clock_share decode_memory_share compute_linear_share",
    ProfileTable: "begin_h step_s names values first_day",
    PowerCapDvfs: "decode_clock_share decode_memory_share compute_linear_share decode_draw_share",
}
"""Fields that are always hashed, by class; those of a scenario by their names in the schema."""
_NAMES = {CostWeights: "tuple8", PrefillDecodeDvfs: "PhaseDvfs"}
"""Names of classes in the schema where they differ."""
_PATHS = ALIASES | FORMER
"""Paths of the scenario's fields by the names in the schema; a name without one is its own path."""
_BUSES = ("bus_ids", "datacenter_buses", "inverter_buses")


def scenario_hash(scenario: Scenario) -> str:
    """SHA-256 of a scenario by schema 1, 16 hexadecimal digits.

    ValueError for a custom clock law whose figures cannot be read.
    """
    return digest([("", scenario)], fields)


def fields(value: object) -> tuple[str, Iterable[tuple[str, Any]]] | None:
    """Return the part of a value that schema 1 hashes; None for a kind that is not in the schema."""
    kind = type(value)
    if kind not in SCHEMA_1:
        return None
    listed, name = SCHEMA_1[kind].split(), _NAMES.get(kind, kind.__name__)
    always = _published(value, listed)
    if isinstance(value, Scenario):
        return name, chain(always, _later_of_parts(value))
    later = {field: default for field, default in _defaults(kind).items() if field not in listed}
    return name, chain(always, ((n, getattr(value, n)) for n, d in later.items() if _is_other(getattr(value, n), d)))


def _published(value: object, listed: list[str]) -> Iterator[tuple[str, Any]]:
    """Return the fields that the schema lists; one marked with ? is left out if it is None."""
    for name in listed:
        field = name.removesuffix("?")
        if isinstance(value, Scenario) and _path(field)[0] in GROUPS and not _has_two_groups(value):
            continue
        content = _hashed(value, field)
        if name == field or content is not None:
            yield "" if isinstance(value, CostWeights) else field, content


def _path(name: str) -> tuple[str, str]:
    """Part or group of devices, "" for the scenario itself, and field that a name of the schema means."""
    part, _, field = _PATHS.get(name, name).rpartition(".")
    return part, field


def _later_of_parts(scenario: Scenario) -> Iterator[tuple[str, Any]]:
    """Fields of a scenario and its parts that are in no list, and not at their default."""
    listed = {_path(field.removesuffix("?")) for field in SCHEMA_1[Scenario].split()}
    parts: dict[str, Any] = {"": scenario} | {name: getattr(scenario, name) for name in PARTS}
    if _has_two_groups(scenario):
        parts |= {name: getattr(scenario, name) for name in GROUPS}
    else:
        yield "devices", scenario.devices
    for path, part in parts.items():
        for name, default in _defaults(type(part)).items():
            is_part = not path and name in (*PARTS, "devices")
            always = name == "regulator_settings" and isinstance(scenario.feeder, ThreePhaseFeeder)
            if (path, name) not in listed and not is_part and (always or _is_other(getattr(part, name), default)):
                yield f"{GROUPS.get(path, path)}.{name}", getattr(part, name)


def _is_other(value: object, default: object) -> bool:
    """Whether a field is not at its default; arrays, which cannot be compared so, have none."""
    return value is not None if default is None else bool(value != default)


def _has_two_groups(scenario: Scenario) -> bool:
    """Return whether the devices are one group of data centres and one of inverters, which the listed names cover."""
    return [device.kind for device in scenario.devices] == list(GROUPS.values())


def _hashed(value: Any, name: str) -> Any:
    """Return the hashed form of a field: its value, and numbers or texts for buses."""
    content = attrgetter(_PATHS.get(name, name))(value) if isinstance(value, Scenario) else getattr(value, name)
    if name not in _BUSES or content is None:
        return content
    feeder = value if isinstance(value, Feeder) else value.feeder
    return content if bus_numbers(feeder.bus_ids) is None else tuple(map(int, content))


def _defaults(kind: type[Any]) -> dict[str, Any]:
    """Fields of a dataclass or named tuple with their defaults."""
    if not dataclasses.is_dataclass(kind):
        return {name: kind._field_defaults.get(name) for name in kind._fields}
    return {
        f.name: f.default if f.default_factory is MISSING else f.default_factory() for f in dataclasses.fields(kind)
    }
