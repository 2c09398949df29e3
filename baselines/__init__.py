"""Controllers that are not learned, written on the public interface only."""

from dcgrid_env.baselines.controller import Controller, Local, LocalController, NeedsPlacement, NeedsRegulators
from dcgrid_env.baselines.hindsight_costs import Published, published
from dcgrid_env.baselines.laws.constant_set_points import ConstantSetPoints, TwoTimescale
from dcgrid_env.baselines.laws.deadband import DeadbandDroop
from dcgrid_env.baselines.laws.droop import Droop
from dcgrid_env.baselines.laws.fixed_smoothing import FixedSmoothing
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.baselines.laws.peak_shaving import PeakShaving
from dcgrid_env.baselines.laws.request_sharing import RequestSharing
from dcgrid_env.baselines.laws.route_to_strongest import RouteToStrongest
from dcgrid_env.baselines.laws.site_return import ReturnByHand, StaggeredReturn
from dcgrid_env.baselines.laws.static import ConstantQ, PlacementRule
from dcgrid_env.baselines.laws.switching import SwitchingReference
from dcgrid_env.baselines.laws.volt_var import VoltVar
from dcgrid_env.baselines.model_aided.model_aided import ModelAided
from dcgrid_env.baselines.model_based.feedback import FeedbackOptimisation
from dcgrid_env.baselines.model_based.mpc import Mpc
from dcgrid_env.baselines.registry import (
    CONTROLLER_REGISTRY,
    CONTROLLERS,
    TUNED,
    ForScenario,
    find_controller,
    make_controller,
)
from dcgrid_env.baselines.rollout import rollout, streaming_rollout
from dcgrid_env.baselines.source_voltage import centred_voltage

__all__ = [
    "CONTROLLERS",
    "CONTROLLER_REGISTRY",
    "TUNED",
    "ConstantQ",
    "ConstantSetPoints",
    "Controller",
    "DeadbandDroop",
    "Droop",
    "FeedbackOptimisation",
    "FixedSmoothing",
    "ForScenario",
    "Local",
    "LocalController",
    "ModelAided",
    "Mpc",
    "NeedsPlacement",
    "NeedsRegulators",
    "NoControl",
    "PeakShaving",
    "PlacementRule",
    "Published",
    "RequestSharing",
    "ReturnByHand",
    "RouteToStrongest",
    "StaggeredReturn",
    "SwitchingReference",
    "TwoTimescale",
    "VoltVar",
    "centred_voltage",
    "find_controller",
    "make_controller",
    "published",
    "rollout",
    "streaming_rollout",
]
