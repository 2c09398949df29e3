"""dcgrid: voltage control of distribution feeders with data centres, for reinforcement learning and power systems."""

from importlib import import_module as _import_module
from typing import Any as _Any

from dcgrid_env.core.metric import Metric
from dcgrid_env.devices import (
    DataCenters,
    Device,
    Inverters,
    LinearDvfs,
    PowerCapDvfs,
    PrefillDecodeDvfs,
    Storages,
    register_device,
)
from dcgrid_env.devices.capacitor_bank.capacitor_control import CapacitorControl
from dcgrid_env.devices.datacenter.batching import Batching
from dcgrid_env.devices.datacenter.cooled_site import Cooling
from dcgrid_env.devices.datacenter.power_smoothing import PowerSmoothing
from dcgrid_env.devices.datacenter.service_levels import ServiceLevels
from dcgrid_env.devices.datacenter.site_storage import SiteStorage
from dcgrid_env.devices.datacenter.waiting_time import Delays, fcfs_delays
from dcgrid_env.devices.datacenter.work_routing import Routing
from dcgrid_env.devices.faults import Fault
from dcgrid_env.devices.ride_through.connection_surrogate import TripWidths
from dcgrid_env.devices.ride_through.rules import RideThrough, UpsRideThrough
from dcgrid_env.devices.ride_through.sags import Sag, virginia_2024
from dcgrid_env.devices.ride_through.voltage_curve import RideThroughCurve
from dcgrid_env.devices.tap_changer.regulator_control import RegulatorControl
from dcgrid_env.devices.tap_changer.regulator_state import RegulatorState
from dcgrid_env.engine.cost.flicker import short_term_flicker
from dcgrid_env.engine.cost.metric_list import METRICS, metrics_in
from dcgrid_env.engine.cost.observation import field_names
from dcgrid_env.engine.cost.reward import CostPrices, cost_prices, end_costs
from dcgrid_env.engine.exogenous.clock_starts import recording_lines
from dcgrid_env.engine.exogenous.forecast import Forecast, episode_hash, forecast, sag_times
from dcgrid_env.engine.exogenous.profile_loads import profile_loads
from dcgrid_env.engine.physics.acting_relays import ActingRelays, BankControl, acting_relays
from dcgrid_env.engine.physics.actions import ActionError, ActionLayout, action_layout
from dcgrid_env.engine.physics.connections import (
    believed_sensitivity,
    nodes_by_bus,
    sensitivity_between_agents,
    sensitivity_to_agents,
)
from dcgrid_env.engine.physics.relay_slopes import RelaySlopes, relay_slopes
from dcgrid_env.engine.record.episode_record import JoinedRecorder, Recorder, Series
from dcgrid_env.engine.record.parquet import ParquetCourse
from dcgrid_env.engine.record.streaming import WHOLE_COURSE_BYTES, PartSink, StreamingRecorder, course_bytes
from dcgrid_env.envs.base import EpisodeCutWarning, HugeObservationWarning
from dcgrid_env.envs.info import info_arrays
from dcgrid_env.envs.parallel import DcgridParallelEnv, env, parallel_env
from dcgrid_env.envs.registration import register as _register
from dcgrid_env.envs.single import DcgridEnv
from dcgrid_env.envs.tensor import TensorEnv, TensorStep
from dcgrid_env.envs.tensor_windows import TensorWindows
from dcgrid_env.envs.vector import DcgridVectorEnv
from dcgrid_env.grid import FEEDER_REGISTRY, FEEDERS, Feeder, FeederError, ThreePhaseFeeder, load_feeder, read_feeder
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from dcgrid_env.grid.random_feeders.random_feeder import random_feeder
from dcgrid_env.powerflow import (
    Control,
    PowerFlowError,
    RatingCoverage,
    Sensitivity,
    Solution,
    branch_loading,
    distflow,
    lindistflow,
    own_sensitivity,
    rating_coverage,
    sensitivity,
    sensitivity_by,
    solver_for,
)
from dcgrid_env.scenario.cost import Cost, CostWeights
from dcgrid_env.scenario.costs.voltage_reference import beyond_band, voltage_deviation, voltage_targets
from dcgrid_env.scenario.errors import ScenarioError
from dcgrid_env.scenario.fingerprint import scenario_hash
from dcgrid_env.scenario.grid_control import GridControl, under_own_control
from dcgrid_env.scenario.grid_request import GridRequest, LoadTarget
from dcgrid_env.scenario.load_profiles import LoadProfiles, ProfileCoverage, profile_begins_h, profile_coverage
from dcgrid_env.scenario.on_feeder import scenario_on
from dcgrid_env.scenario.presets import IDS, PRESETS, SCENARIO_REGISTRY, make_scenario
from dcgrid_env.scenario.scenario import Scenario
from dcgrid_env.scenario.sensing import Sensing
from dcgrid_env.scenario.workload import Background, Workload

__version__ = "1.0.0"

__all__ = [
    "FEEDERS",
    "FEEDER_REGISTRY",
    "IDS",
    "METRICS",
    "PRESETS",
    "SCENARIO_REGISTRY",
    "WHOLE_COURSE_BYTES",
    "ActingRelays",
    "ActionError",
    "ActionLayout",
    "Background",
    "BankControl",
    "Batching",
    "CapacitorControl",
    "Control",
    "Cooling",
    "Cost",
    "CostPrices",
    "CostWeights",
    "DataCenters",
    "DcgridEnv",
    "DcgridParallelEnv",
    "DcgridVectorEnv",
    "Delays",
    "Device",
    "EpisodeCutWarning",
    "Fault",
    "Feeder",
    "FeederError",
    "Forecast",
    "GridControl",
    "GridRequest",
    "HugeObservationWarning",
    "Inverters",
    "JoinedRecorder",
    "LinearDvfs",
    "LoadProfiles",
    "LoadTarget",
    "Metric",
    "ParquetCourse",
    "PartSink",
    "PowerCapDvfs",
    "PowerFlowError",
    "PowerSmoothing",
    "PrefillDecodeDvfs",
    "ProfileCoverage",
    "RandomFeeders",
    "RatingCoverage",
    "Recorder",
    "RegulatorControl",
    "RegulatorState",
    "RelaySlopes",
    "RideThrough",
    "RideThroughCurve",
    "Routing",
    "Sag",
    "Scenario",
    "ScenarioError",
    "Sensing",
    "Sensitivity",
    "Series",
    "ServiceLevels",
    "SiteStorage",
    "Solution",
    "Storages",
    "StreamingRecorder",
    "TensorEnv",
    "TensorStep",
    "TensorWindows",
    "ThreePhaseFeeder",
    "TripWidths",
    "UpsRideThrough",
    "Workload",
    "__version__",
    "acting_relays",
    "action_layout",
    "believed_sensitivity",
    "beyond_band",
    "branch_loading",
    "cost_prices",
    "course_bytes",
    "distflow",
    "end_costs",
    "env",
    "episode_hash",
    "fcfs_delays",
    "field_names",
    "forecast",
    "info_arrays",
    "lindistflow",
    "load_feeder",
    "make_scenario",
    "metrics_in",
    "nodes_by_bus",
    "own_sensitivity",
    "parallel_env",
    "profile_begins_h",
    "profile_coverage",
    "profile_loads",
    "random_feeder",
    "rating_coverage",
    "read_feeder",
    "recording_lines",
    "register_device",
    "relay_slopes",
    "sag_times",
    "scenario_hash",
    "scenario_on",
    "score",  # pyright: ignore[reportUnsupportedDunderAll]
    "sensitivity",
    "sensitivity_between_agents",
    "sensitivity_by",
    "sensitivity_to_agents",
    "short_term_flicker",
    "solver_for",
    "under_own_control",
    "virginia_2024",
    "voltage_deviation",
    "voltage_targets",
]

_register()


def __getattr__(name: str) -> _Any:
    """Return what a layer below defines; it is imported on first use, so that importing the package stays light."""
    if name == "score":
        return _import_module("dcgrid_env.agents.scoring").score
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
