"""Controllers made by hand, through the public interface alone."""

from dcgrid_env.baselines.controller import Controller, Local, LocalController, Placed
from dcgrid_env.baselines.deadband import DeadbandDroop
from dcgrid_env.baselines.droop import Droop
from dcgrid_env.baselines.feedback import FeedbackOptimisation
from dcgrid_env.baselines.mpc import Mpc
from dcgrid_env.baselines.named import CONTROLLERS, TUNED, make_controller
from dcgrid_env.baselines.none import NoControl
from dcgrid_env.baselines.published import Published, published
from dcgrid_env.baselines.rollout import rollout
from dcgrid_env.baselines.static import ConstantQ, PlacementRule
from dcgrid_env.baselines.switching import SwitchingReference
from dcgrid_env.baselines.volt_var import VoltVar

__all__ = [
    "CONTROLLERS",
    "TUNED",
    "ConstantQ",
    "Controller",
    "DeadbandDroop",
    "Droop",
    "FeedbackOptimisation",
    "Local",
    "LocalController",
    "Mpc",
    "NoControl",
    "Placed",
    "PlacementRule",
    "Published",
    "SwitchingReference",
    "VoltVar",
    "make_controller",
    "published",
    "rollout",
]
