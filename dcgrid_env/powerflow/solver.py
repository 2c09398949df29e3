"""One protocol for every power flow, and the lookup of the solver that fits a kind of feeder."""

from __future__ import annotations

import reprlib
from functools import cache
from typing import Any, Protocol

from dcgrid_env.core.arrays import Array
from dcgrid_env.grid import Feeder, ThreePhaseFeeder
from dcgrid_env.grid.random_feeders.feeder_batch import FeederBatch
from dcgrid_env.powerflow.balanced.member_batch import member_distflow, member_lindistflow
from dcgrid_env.powerflow.balanced.solvers import solve_distflow, solve_lindistflow
from dcgrid_env.powerflow.control import Control
from dcgrid_env.powerflow.solution import PowerFlowError, Solution
from dcgrid_env.powerflow.unbalanced.sweep import solve_unbalanced
from dcgrid_env.powerflow.unbalanced.three_phase_solution import ThreePhaseSolution

AnySolution = Solution | ThreePhaseSolution
"""What a power flow returns, by the kind of feeder; the fields that both have mean the same."""


class Solver(Protocol):
    """Solves the power flow of one kind of feeder, for one feeder or a batch, by one method."""

    def __call__(
        self,
        feeder: Any,
        p_kw: Array,
        q_kvar: Array,
        source_voltage_pu: Array | float | None,
        control: Control | None = None,
        start: Array | None = None,
    ) -> AnySolution:
        """Solve the power flow.

        Parameters
        ----------
        feeder
            A feeder of the kind that the solver is for.
        p_kw, q_kvar
            Net load at each node of a balanced feeder, or leg of a three-phase one (consumption positive), shape
            (..., n_node) or (..., n_leg), NumPy arrays or torch tensors.
        source_voltage_pu
            Voltage of the source, p.u., a number or an array that broadcasts to shape (...).
        control
            Changes of the grid by devices; None for no change.
        start
            ``Solution.restart`` of a similar power flow of the same shape, to start from. Zeros and None mean without a
            start, and a start that does not converge is discarded.

        Raises
        ------
        PowerFlowError
            For invalid input, including a control that the feeder does not support. A load without a solution does
            not raise an error: see ``Solution.converged``.
        """
        ...


_SOLVERS: dict[type[Any], dict[str, Solver]] = {
    Feeder: {"distflow": solve_distflow, "lindistflow": solve_lindistflow},
    FeederBatch: {"distflow": member_distflow, "lindistflow": member_lindistflow},
    ThreePhaseFeeder: {"sweep": solve_unbalanced},
}


def solver_for(feeder: Any, method: str) -> Solver:
    """Find the solver of a feeder's kind by the name of its method, such as ``"distflow"`` or ``"lindistflow"``.

    Raises
    ------
    PowerFlowError
        For a value that is not a feeder, or a method that its kind does not have; the message lists the methods.
    """
    methods = _methods_of(type(feeder))
    if not methods:
        raise PowerFlowError(f"feeder is {reprlib.repr(feeder)}; give a Feeder, for instance load_feeder('ieee33')")
    if method not in methods:
        raise PowerFlowError(f"feeder {feeder.name!r}: no power flow {method!r}; choose one of {', '.join(methods)}")
    return methods[method]


@cache
def _methods_of(kind: type[Any]) -> dict[str, Solver]:
    return next((_SOLVERS[base] for base in kind.__mro__ if base in _SOLVERS), {})
