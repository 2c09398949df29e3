"""Speed of the power flow here and in other libraries: a part of the command ``speed``.

Every rate is listed with the worst voltage error relative to a solution at a far finer tolerance.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.core.suggestions import from_clone
from dcgrid_env.grid import Feeder
from dcgrid_env.powerflow import Solution, distflow, lindistflow
from dcgrid_env.scenario.scenario import Scenario
from docs.studies.speed.measuring import Row, rate
from docs.studies.speed.reference_solvers import REFERENCE_SOLVERS, ReferenceSolver, missing

FloatArray = NDArray[np.float64]

EXACT_KVA = 1e-9  # tolerance of the solves that errors are taken against; the default is 1e-4
CHANGE = 0.002  # of every load between two solves of which the second starts warm
SINGLES = 16  # different loads that single solves take turns with
MISSING = f"not installed ({from_clone('bench')})"


@dataclass(frozen=True)
class Case:
    """Loads of a batch of one feeder, (row, bus), and their exact voltages."""

    feeder: Feeder
    v0_pu: float
    p_kw: FloatArray
    q_kvar: FloatArray
    v_pu: FloatArray

    @classmethod
    def draw(cls, scenario: Scenario, n_feeders: int) -> Case:
        """The scenario's feeder with its own load, each bus's times 0.5 to 1.5 at random, and its capacitors."""
        feeder, rng = scenario.feeder, np.random.default_rng(0)
        p_kw = feeder.p_load_kw * rng.uniform(0.5, 1.5, (n_feeders, feeder.n_bus))
        q_kvar = feeder.q_load_kvar * rng.uniform(0.5, 1.5, (n_feeders, feeder.n_bus)) - feeder.capacitor_kvar
        return cls._exact(feeder, scenario.source_voltage_pu, p_kw, q_kvar)

    def changed(self) -> Case:
        """A case with every row's loads up or down by ``CHANGE``."""
        factor = 1.0 + CHANGE * np.random.default_rng(1).choice([-1.0, 1.0], (len(self.p_kw), 1))
        return self._exact(self.feeder, self.v0_pu, self.p_kw * factor, self.q_kvar * factor)

    @classmethod
    def _exact(cls, feeder: Feeder, v0_pu: float, p_kw: FloatArray, q_kvar: FloatArray) -> Case:
        exact = distflow(feeder, p_kw, q_kvar, v0_pu, tolerance_kva=EXACT_KVA)
        if not exact.converged.all():
            raise ValueError(f"feeder {feeder.name!r} cannot carry the loads drawn for it")
        return cls(feeder, v0_pu, p_kw, q_kvar, exact.v_pu)

    def error_pu(self, v_pu: Any) -> float:
        """Worst difference to the exact voltages of the first rows, as many as given."""
        return float(np.abs(np.asarray(v_pu) - self.v_pu[: len(v_pu)]).max())

    def singles(self) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Loads of some rows, one after the other."""
        return zip(self.p_kw[:SINGLES], self.q_kvar[:SINGLES], strict=True)


def power_flow_rows(case: Case, seconds: float) -> Iterator[Row]:
    """The power flow alone: batches from a cold and a warm start, linearised; one feeder from Python."""
    n_feeders, loads, v0 = len(case.p_kw), (case.p_kw, case.q_kvar), case.v0_pu
    changed = case.changed()

    def timed(name: str, against: Case, solve: Callable[[], Solution]) -> Row:
        return Row(name, rate(solve, n_feeders, seconds), "power flows/s", against.error_pu(solve().v_pu))

    cold = distflow(case.feeder, *loads, v0)
    yield timed(f"distflow, {n_feeders} feeders, cold start", case, lambda: distflow(case.feeder, *loads, v0))
    yield timed(
        f"distflow, {n_feeders} feeders, warm start, loads {CHANGE:.1%} off",
        changed,
        lambda: distflow(changed.feeder, changed.p_kw, changed.q_kvar, v0, warm=cold),
    )
    name = f"lindistflow, {n_feeders} feeders (its error is the model's)"
    yield timed(name, case, lambda: lindistflow(case.feeder, *loads, v0))
    yield from _single_rows(case, changed, seconds)


def _single_rows(case: Case, changed: Case, seconds: float) -> Iterator[Row]:
    feeder, v0 = case.feeder, case.v0_pu
    starts = [distflow(feeder, p, q, v0) for p, q in case.singles()]
    v_cold = [start.v_pu for start in starts]
    v_warm = [distflow(feeder, p, q, v0, warm=w).v_pu for (p, q), w in zip(changed.singles(), starts, strict=True)]
    cold = itertools.cycle(case.singles())
    warm = itertools.cycle([(p, q, w) for (p, q), w in zip(changed.singles(), starts, strict=True)])

    def solve_cold() -> None:
        p_kw, q_kvar = next(cold)
        distflow(feeder, p_kw, q_kvar, v0)

    def solve_warm() -> None:
        p_kw, q_kvar, start = next(warm)
        distflow(feeder, p_kw, q_kvar, v0, warm=start)

    per_s = rate(solve_cold, 1, seconds)
    yield Row("distflow, one feeder, cold start", per_s, "power flows/s", case.error_pu(v_cold))
    took_us = 1e6 / rate(solve_warm, 1, seconds)
    yield Row("distflow, one feeder, warm start", took_us, "µs", changed.error_pu(v_warm))


def reference_rows(case: Case, seconds: float) -> Iterator[Row]:
    """The other libraries on the same feeder and loads: one after the other and, where they can, as a batch."""
    for name, (build, _) in REFERENCE_SOLVERS.items():
        if missing(name):
            yield Row(name, None, MISSING)
            continue
        try:
            solver = build(case.feeder, case.v0_pu)
        except ImportError as error:  # a release that lacks what we call
            yield Row(name, None, f"cannot be imported: {error}")
            continue
        yield _single_reference_row(solver, case, seconds)
        if solver.solve_batch is not None:
            work = partial(solver.solve_batch, case.p_kw, case.q_kvar)
            per_s = rate(work, len(case.p_kw), seconds)
            yield Row(f"{solver.name}, {len(case.p_kw)} feeders", per_s, "power flows/s", case.error_pu(work()))


def _single_reference_row(solver: ReferenceSolver, case: Case, seconds: float) -> Row:
    error = case.error_pu([solver.solve(p, q) for p, q in case.singles()])
    turns = itertools.cycle(case.singles())
    per_s = rate(lambda: solver.solve(*next(turns)), 1, seconds)
    return Row(f"{solver.name}, one feeder", per_s, "power flows/s", error)
