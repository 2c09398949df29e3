"""Power flow of radial feeders: one method a file, each ``solve(feeder, p_kw, q_kvar) -> Solution``."""

from dcgrid_env.powerflow.balanced.distflow import distflow
from dcgrid_env.powerflow.balanced.lindistflow import lindistflow
from dcgrid_env.powerflow.solution import PowerFlowError, Solution

__all__ = ["PowerFlowError", "Solution", "distflow", "lindistflow"]
