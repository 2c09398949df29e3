"""Speed of the three-phase power flow, OpenDSS and power-grid-model: part of the command ``speed``.

The points are random: each leg's load times 0.5 to 1.5, taps within two of the base's, capacitors on or off. OpenDSS
is timed twice: for its ``Solve`` alone, and for the whole step of an environment around it. That step also sets all
loads, taps and capacitors and reads all voltages.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.grid import ThreePhaseFeeder, load_feeder
from dcgrid_env.powerflow import Control, solve_unbalanced
from docs.studies.speed.measuring import Row, rate
from docs.studies.speed.power_flow_rates import MISSING, SINGLES

FloatArray = NDArray[np.float64]
FEEDER = "ieee123-3ph"
EXACT_PU = 1e-13
OPENDSS_PU = 1e-8


@dataclass(frozen=True)
class ThreePhaseCase:
    """Random points of a three-phase feeder and their exact voltages."""

    feeder: ThreePhaseFeeder
    p_kw: FloatArray
    q_kvar: FloatArray
    control: Control
    v_pu: FloatArray

    @classmethod
    def draw(cls, n_points: int, name: str = FEEDER) -> ThreePhaseCase:
        """Draw the points, the same at each call."""
        feeder, rng = load_feeder(name), np.random.default_rng(0)
        p_kw = feeder.p_load_kw * rng.uniform(0.5, 1.5, (n_points, feeder.n_leg))
        q_kvar = feeder.q_load_kvar * rng.uniform(0.5, 1.5, (n_points, feeder.n_leg))
        tap = feeder.base_tap + rng.integers(-2, 3, (n_points, feeder.n_regulator))
        state = rng.integers(0, 2, (n_points, feeder.n_capacitor)).astype(float)
        control = Control(tap_ratio=feeder.tap_ratio(tap), capacitor_on=state)
        exact = solve_unbalanced(feeder, p_kw, q_kvar, None, control, tolerance_pu=EXACT_PU)
        if not exact.converged.all():
            raise ValueError(f"feeder {feeder.name!r} cannot carry the loads drawn for it")
        return cls(feeder, p_kw, q_kvar, control, exact.v_pu)

    def error_pu(self, v_pu: Any) -> float:
        """Worst difference to the exact voltages of the first points, as many as given."""
        return float(np.abs(np.asarray(v_pu) - self.v_pu[: len(v_pu)]).max())

    def point(self, k: int) -> tuple[FloatArray, FloatArray, float, Any, Any]:
        """What one point is: powers, source voltage, ratios and states."""
        ratio, state = self.control.tap_ratio, self.control.capacitor_on
        assert ratio is not None
        assert state is not None
        return self.p_kw[k], self.q_kvar[k], self.feeder.v0_pu, ratio[k], state[k]


def three_phase_rows(case: ThreePhaseCase, seconds: float) -> Iterator[Row]:
    """The sweep: a batch, cold and warm, one at a time, and its derivative."""
    feeder, n = case.feeder, len(case.p_kw)
    given = (feeder, case.p_kw, case.q_kvar, None, case.control)
    cold = solve_unbalanced(*given)
    label = f"three-phase sweep, {feeder.name}"
    per_s = rate(lambda: solve_unbalanced(*given), n, seconds)
    yield Row(f"{label}, {n} points, cold start", per_s, "power flows/s", case.error_pu(cold.v_pu))
    warm = solve_unbalanced(*given, start=cold)
    per_s = rate(lambda: solve_unbalanced(*given, start=cold), n, seconds)
    yield Row(f"{label}, {n} points, from their own solution", per_s, "power flows/s", case.error_pu(warm.v_pu))
    points = [case.point(k) for k in range(min(SINGLES, n))]
    turns = itertools.cycle(points)

    def one() -> Any:
        p_kw, q_kvar, source_pu, ratio, state = next(turns)
        return solve_unbalanced(feeder, p_kw, q_kvar, source_pu, Control(tap_ratio=ratio, capacitor_on=state)).v_pu

    error = case.error_pu([one() for _ in points])
    turns = itertools.cycle(points)
    yield Row(f"{label}, one point, cold start", rate(one, 1, seconds), "power flows/s", error)
    if find_spec("torch") is not None:
        yield _derivative_row(case, label, seconds)


def _derivative_row(case: ThreePhaseCase, label: str, seconds: float) -> Row:
    import torch

    p_kw, q_kvar = (torch.tensor(a, requires_grad=True) for a in (case.p_kw, case.q_kvar))
    total = solve_unbalanced(case.feeder, p_kw, q_kvar, None, case.control).v_pu.sum()

    def backward() -> Any:
        return torch.autograd.grad(total, (p_kw, q_kvar), retain_graph=True)

    return Row(
        f"{label}, derivative of {len(case.p_kw)} points alone", rate(backward, len(case.p_kw), seconds), "points/s"
    )


def three_phase_reference_rows(case: ThreePhaseCase, seconds: float) -> Iterator[Row]:
    """Yield rows of OpenDSS's Solve on the same points, and of power-grid-model and dcgrid on a plain feeder."""
    yield from _opendss_rows(case, seconds)
    name = f"power-grid-model, asymmetric, plain {case.feeder.name}"
    if find_spec("power_grid_model") is None:
        yield Row(name, None, MISSING)
        return
    from docs.studies.speed.three_phase_grid_model import plain_feeder, power_grid_model_batch

    plain = plain_feeder(case.feeder)
    p_kw, q_kvar = _at_first_nodes(case, plain)
    n, exact = len(p_kw), solve_unbalanced(plain, p_kw, q_kvar, tolerance_pu=EXACT_PU).v_pu
    theirs = power_grid_model_batch(plain)
    for one, solve in ((name, theirs), (f"three-phase sweep, plain {case.feeder.name}", partial(_voltages, plain))):
        error = float(np.abs(solve(p_kw, q_kvar) - exact).max())
        yield Row(f"{one}, {n} points", rate(partial(solve, p_kw, q_kvar), n, seconds), "power flows/s", error)


def _voltages(feeder: ThreePhaseFeeder, p_kw: FloatArray, q_kvar: FloatArray) -> FloatArray:
    return solve_unbalanced(feeder, p_kw, q_kvar).v_pu


def _at_first_nodes(case: ThreePhaseCase, plain: ThreePhaseFeeder) -> tuple[FloatArray, FloatArray]:
    """Powers of a plain feeder's legs: each load's leg from its first node to ground, four fifths of it."""
    feeder, n_load = case.feeder, case.feeder.first_device_leg
    to = [plain.nodes_of(feeder.bus_ids[feeder.node_bus[k]])[0] for k in feeder.load_legs.node]
    first = [feeder.first_node[feeder.node_bus[k]] for k in feeder.load_legs.node]
    to = np.array(to) + feeder.load_legs.node - np.array(first)
    powers = np.zeros((2, len(case.p_kw), plain.n_leg))
    for out, values in zip(powers, (case.p_kw, case.q_kvar), strict=True):
        for leg, node in enumerate(to):
            out[:, node] += 0.8 * values[:, leg]
    assert plain.first_device_leg == 0
    assert n_load == len(to)
    return powers[0], powers[1]


def _opendss_rows(case: ThreePhaseCase, seconds: float) -> Iterator[Row]:
    alone, looped = f"OpenDSS, Solve alone, {case.feeder.name}", f"OpenDSS in the loop, {case.feeder.name}"
    if find_spec("dss") is None:
        yield from (Row(name, None, MISSING) for name in (alone, looped))
        return
    from docs.studies.speed.opendss_circuit import OpenDss

    circuit = OpenDss(case.feeder, OPENDSS_PU, has_devices=False)
    points = [case.point(k) for k in range(min(SINGLES, len(case.p_kw)))]
    error = case.error_pu([np.abs(circuit.solve(*point)[0]) for point in points])
    spent, turns, until = [], itertools.cycle(points), perf_counter() + seconds
    while perf_counter() < until:
        circuit.set_point(*next(turns))
        start = perf_counter()
        circuit.solve_again()
        spent.append(perf_counter() - start)
    yield Row(alone, 1.0 / float(np.median(spent)), "power flows/s", error)
    per_s = rate(lambda: circuit.solve(*next(turns)), 1, seconds)
    yield Row(f"{looped}: set loads and taps, Solve, read voltages", per_s, "steps/s", error)
