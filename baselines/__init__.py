"""Controllers made by hand, through the public interface alone."""

from dcgrid_env.baselines.controller import Controller, Local, LocalController
from dcgrid_env.baselines.droop import Droop
from dcgrid_env.baselines.named import CONTROLLERS, make_controller
from dcgrid_env.baselines.none import NoControl
from dcgrid_env.baselines.rollout import rollout

__all__ = ["CONTROLLERS", "Controller", "Droop", "Local", "LocalController", "NoControl", "make_controller", "rollout"]
