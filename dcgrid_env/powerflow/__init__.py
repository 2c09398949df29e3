"""Power flow of radial feeders: solvers of one protocol, found by the kind of feeder, and what they return."""

from dcgrid_env.powerflow.balanced.distflow import distflow
from dcgrid_env.powerflow.balanced.lindistflow import lindistflow
from dcgrid_env.powerflow.control import Control
from dcgrid_env.powerflow.sensitivity import Sensitivity, own_sensitivity, sensitivity
from dcgrid_env.powerflow.solution import PowerFlowError, Solution
from dcgrid_env.powerflow.solver import Solver, solver_for

__all__ = [
    "Control",
    "PowerFlowError",
    "Sensitivity",
    "Solution",
    "Solver",
    "distflow",
    "lindistflow",
    "own_sensitivity",
    "sensitivity",
    "solver_for",
]
