"""dcgrid: voltage control of distribution feeders with data centres, for reinforcement learning and power systems."""

import gymnasium as _gymnasium
import pettingzoo as _pettingzoo

from dcgrid_env.devices import DataCenters, Device, Inverters, LinearDvfs, PrefillDecodeDvfs, register_device
from dcgrid_env.devices.faults import Fault
from dcgrid_env.engine.actions import ActionError, ActionLayout, action_layout
from dcgrid_env.engine.forecast import Forecast, episode_hash, forecast
from dcgrid_env.engine.metrics import Recorder, Series
from dcgrid_env.engine.observation import field_names
from dcgrid_env.envs.parallel import DcgridParallelEnv, env, parallel_env
from dcgrid_env.envs.single import DcgridEnv
from dcgrid_env.envs.tensor import TensorEnv, TensorStep
from dcgrid_env.envs.vector import DcgridVectorEnv
from dcgrid_env.grid import FEEDERS, Feeder, FeederError, load_feeder
from dcgrid_env.powerflow import PowerFlowError, Solution, distflow, lindistflow
from dcgrid_env.scenario.background import Background
from dcgrid_env.scenario.cost import Cost, CostWeights
from dcgrid_env.scenario.errors import ScenarioError
from dcgrid_env.scenario.fingerprint import scenario_hash
from dcgrid_env.scenario.presets import PRESETS, make_scenario
from dcgrid_env.scenario.scenario import Scenario
from dcgrid_env.scenario.sensing import Sensing
from dcgrid_env.scenario.workload import Workload

__version__ = "0.1.0"

__all__ = [
    "FEEDERS",
    "IDS",
    "PRESETS",
    "ActionError",
    "ActionLayout",
    "Background",
    "Cost",
    "CostWeights",
    "DataCenters",
    "DcgridEnv",
    "DcgridParallelEnv",
    "DcgridVectorEnv",
    "Device",
    "Fault",
    "Feeder",
    "FeederError",
    "Forecast",
    "Inverters",
    "LinearDvfs",
    "PowerFlowError",
    "PrefillDecodeDvfs",
    "Recorder",
    "Scenario",
    "ScenarioError",
    "Sensing",
    "Series",
    "Solution",
    "TensorEnv",
    "TensorStep",
    "Workload",
    "action_layout",
    "distflow",
    "env",
    "episode_hash",
    "field_names",
    "forecast",
    "lindistflow",
    "load_feeder",
    "make_scenario",
    "parallel_env",
    "register_device",
    "scenario_hash",
]

IDS = {
    "dcgrid/Toy6-v0": "toy6",
    "dcgrid/IEEE123-v0": "ieee123",
    "dcgrid/IEEE33Weak-v0": "ieee33-weak",
    "dcgrid/IEEE33-v0": "ieee33",
    "dcgrid/Das69-v0": "das69",
    "dcgrid/Khodr141-v0": "khodr141",
    "dcgrid/Bursty-v0": "bursty",
    "dcgrid/Sync-v0": "sync",
    "dcgrid/Training-v0": "training",
    "dcgrid/Mixed-v0": "mixed",
    "dcgrid/Fault-v0": "fault",
    "dcgrid/Robust-v0": "robust",
    "dcgrid/Scale32-v0": "scale-32",
}
"""Registered ids, for Gymnasium and, where its release has a registry, for PettingZoo, and their scenarios."""


def _register() -> None:
    for name, scenario in IDS.items():
        if name not in _gymnasium.registry:
            _gymnasium.register(
                name,
                entry_point="dcgrid_env.envs.single:DcgridEnv",
                vector_entry_point="dcgrid_env.envs.vector:DcgridVectorEnv",
                # The environment checks its own actions, with better messages; the generic checker costs a third of
                # the step. gymnasium.utils.env_checker.check_env passes and is among the tests.
                disable_env_checker=True,
                kwargs={"scenario": scenario},
            )
        if hasattr(_pettingzoo, "register") and name not in _pettingzoo.parallel_registry:
            _pettingzoo.register("parallel", name, "dcgrid_env:parallel_env", kwargs={"scenario": scenario})
            _pettingzoo.register("aec", name, "dcgrid_env:env", kwargs={"scenario": scenario})


_register()
