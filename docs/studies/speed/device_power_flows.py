"""Speed of power flows of torch tensors on a device, in either precision: a part of the command ``speed``.

The loads are those of the rows without torch, solved from a cold start, also with the derivative of the voltages by
all loads. The three-phase sweep has two forms: a compiled one for CPU tensors, and one in array operations, by the
impedance matrices of the zones between regulators. Other devices run the second, which is also measured on the CPU.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from dcgrid_env.powerflow import Control, distflow, solve_unbalanced
from dcgrid_env.powerflow.unbalanced.array_form import sweep_arrays
from dcgrid_env.powerflow.unbalanced.sweep import MAX_SWEEPS, TOLERANCE_PU
from docs.studies.speed.measuring import Row
from docs.studies.speed.power_flow_rates import Case
from docs.studies.speed.tensors import PRECISIONS, kind_of, measured
from docs.studies.speed.three_phase_rates import ThreePhaseCase

UNIT = "power flows/s"


def device_power_flow_rows(case: Case, three_phase: ThreePhaseCase, device: str, seconds: float) -> Iterator[Row]:
    """Power flows on a device that ``kind_of`` knows, without and with the derivative, in float32 and float64."""
    forms: dict[str, tuple[Any, Callable[[str], Callable[[Any, Any], Any]]]] = {
        "distflow": (case, lambda precision: partial(distflow, case.feeder, v0_pu=case.v0_pu)),
        f"three-phase sweep, {three_phase.feeder.name}": (three_phase, partial(_sweep, three_phase, device)),
    }
    if kind_of(device) == "cpu":
        name = f"three-phase sweep, {three_phase.feeder.name}, in array operations"
        forms[name] = three_phase, partial(_array_form, three_phase, device)
    for precision in PRECISIONS:
        for name, (points, made) in forms.items():
            yield from _rows(name, points, made(precision), device, precision, seconds)


def _rows(
    name: str, points: Any, solve: Callable[[Any, Any], Any], device: str, precision: str, seconds: float
) -> Iterator[Row]:
    n = len(points.p_kw)
    loads = partial(_loads, points, device, precision)
    for gradient in (False, True):
        label = f"{name}, {n} points, torch {device} {precision}" + (", with the derivative" if gradient else "")
        per_s = measured(lambda gradient=gradient: _work(solve, *loads(gradient)), n, device, seconds)
        error_pu = None
        if per_s is not None and not gradient:
            error_pu = points.error_pu(solve(*loads(False)).v_pu.cpu().numpy())
        yield Row(label, per_s, UNIT if per_s is not None else "does not fit into memory", error_pu)


def _loads(points: Any, device: str, precision: str, gradient: bool) -> tuple[Any, Any]:
    import torch

    kind = {"dtype": getattr(torch, precision), "device": device, "requires_grad": gradient}
    return torch.tensor(points.p_kw, **kind), torch.tensor(points.q_kvar, **kind)


def _work(solve: Callable[[Any, Any], Any], p_kw: Any, q_kvar: Any) -> Callable[[], object]:
    """What solves once, and differentiates if the loads ask for it."""
    import torch

    def work() -> None:
        v_pu = solve(p_kw, q_kvar).v_pu
        if p_kw.requires_grad:
            torch.autograd.grad(v_pu.sum(), (p_kw, q_kvar))
        if p_kw.is_cuda:
            torch.cuda.synchronize()

    return work


def _sweep(points: ThreePhaseCase, device: str, precision: str) -> Callable[[Any, Any], Any]:
    ratio, state = _equipment(points, device, precision)
    return partial(_solved, points, Control(tap_ratio=ratio, capacitor_on=state))


def _solved(points: ThreePhaseCase, control: Control, p_kw: Any, q_kvar: Any) -> Any:
    return solve_unbalanced(points.feeder, p_kw, q_kvar, None, control)


def _array_form(points: ThreePhaseCase, device: str, precision: str) -> Callable[[Any, Any], Any]:
    ratio, state = _equipment(points, device, precision)

    def solve(p_kw: Any, q_kvar: Any) -> Any:
        source_pu = p_kw.new_full(p_kw.shape[:-1], points.feeder.v0_pu)
        return sweep_arrays(points.feeder, (p_kw, q_kvar, source_pu, ratio, state), None, TOLERANCE_PU, MAX_SWEEPS)

    return solve


def _equipment(points: ThreePhaseCase, device: str, precision: str) -> tuple[Any, Any]:
    """Ratios and states of the points as tensors."""
    import torch

    kind = {"dtype": getattr(torch, precision), "device": device}
    of_points = (points.control.tap_ratio, points.control.capacitor_on)
    ratio, state = (torch.tensor(np.asarray(a, float), **kind) for a in of_points)
    return ratio, state
