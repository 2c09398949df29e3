"""Controllers made by hand, through the public interface alone."""

from dcgrid_env.baselines.controller import Controller, Local, LocalController, Placed
from dcgrid_env.baselines.deadband import DeadbandDroop
from dcgrid_env.baselines.droop import Droop
from dcgrid_env.baselines.named import CONTROLLERS, make_controller
from dcgrid_env.baselines.none import NoControl
from dcgrid_env.baselines.rollout import rollout
from dcgrid_env.baselines.static import ConstantQ, PlacementRule
from dcgrid_env.baselines.switching import SwitchingReference
from dcgrid_env.baselines.volt_var import VoltVar

__all__ = [
    "CONTROLLERS",
    "ConstantQ",
    "Controller",
    "DeadbandDroop",
    "Droop",
    "Local",
    "LocalController",
    "NoControl",
    "Placed",
    "PlacementRule",
    "SwitchingReference",
    "VoltVar",
    "make_controller",
    "rollout",
]
