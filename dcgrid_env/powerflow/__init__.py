"""Power flow of radial feeders: solvers of one protocol, found by the kind of feeder, and what they return."""

from dcgrid_env.powerflow.balanced.distflow import distflow
from dcgrid_env.powerflow.balanced.lindistflow import lindistflow
from dcgrid_env.powerflow.control import Control
from dcgrid_env.powerflow.loading import (
    RatingCoverage,
    branch_loading,
    has_ratings,
    n_loading,
    rated_nodes,
    rating_coverage,
)
from dcgrid_env.powerflow.sensitivity import Sensitivity, own_sensitivity, sensitivity, sensitivity_by
from dcgrid_env.powerflow.solution import PowerFlowError, Solution
from dcgrid_env.powerflow.solver import AnySolution, Solver, solver_for
from dcgrid_env.powerflow.unbalance import nema_unbalance, three_phase_nodes, unbalance_factor
from dcgrid_env.powerflow.unbalanced.linearised import Linearised, linearise
from dcgrid_env.powerflow.unbalanced.sweep import solve_unbalanced
from dcgrid_env.powerflow.unbalanced.three_phase_solution import BranchFlows, ThreePhaseSolution, branch_flows

__all__ = [
    "AnySolution",
    "BranchFlows",
    "Control",
    "Linearised",
    "PowerFlowError",
    "RatingCoverage",
    "Sensitivity",
    "Solution",
    "Solver",
    "ThreePhaseSolution",
    "branch_flows",
    "branch_loading",
    "distflow",
    "has_ratings",
    "lindistflow",
    "linearise",
    "n_loading",
    "nema_unbalance",
    "own_sensitivity",
    "rated_nodes",
    "rating_coverage",
    "sensitivity",
    "sensitivity_by",
    "solve_unbalanced",
    "solver_for",
    "three_phase_nodes",
    "unbalance_factor",
]
