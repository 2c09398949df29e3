"""The course of an episode as a table: a row a step, with the state at its end."""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env.engine.dynamics import device_slices
from dcgrid_env.engine.metrics import Series


def course_table(part: Series, first_step: int) -> dict[str, np.ndarray]:
    """Columns of some steps of an episode, ``(step,)`` each, those before being ``first_step`` many.

    ``step`` (from 1 on) and ``t_s``; ``cost_j``, the step's share of J times T, and its terms ``cost.NAME``;
    ``loss_kw``; ``v_pu.NODE`` of every node; ``p_kw.AGENT``, the draw, and ``q_kvar.AGENT``, the reactive injection;
    ``FIELD.AGENT`` for each field of a device's state that is one number an agent, as ``f_mhz.dc_0``; and of a
    three-phase feeder ``tap.REGULATOR`` and ``capacitor_on.BANK``.
    """
    s = part.scenario
    step = np.arange(first_step + 1, first_step + 1 + len(part.cost_j), dtype=np.int32)
    columns: dict[str, np.ndarray] = {"step": step, "t_s": step * float(s.dt_s), "cost_j": part.cost_j}
    columns |= {f"cost.{name}": _single(values) for name, values in part.costs.items()}
    columns["loss_kw"] = _single(part.loss_kw)
    columns |= _of_each("v_pu", s.feeder.node_ids, part.v_pu[1:])
    columns |= _of_each("p_kw", s.agents, part.p_kw)
    columns |= _of_each("q_kvar", s.agents, part.q_kvar)
    for cut, state in zip(device_slices(s), part.devices, strict=True):
        own: dict[str, np.ndarray] = {}
        _collect(state, len(s.agents[cut]), own)
        for field, values in own.items():
            columns |= _of_each(field, s.agents[cut], values[1:])
    if part.three_phase is not None:
        regulators, banks = part.three_phase.equipment
        columns |= _of_each("tap", range(regulators.tap.shape[1]), regulators.tap[1:])
        columns |= _of_each("capacitor_on", range(banks.on.shape[1]), banks.on[1:])
    return columns


def _single(values: np.ndarray) -> np.ndarray:
    return values.astype(np.float32)


def _of_each(name: str, each: Any, values: np.ndarray) -> dict[str, np.ndarray]:
    return {f"{name}.{one}": _single(values[:, i]) for i, one in enumerate(each)}


def _collect(state: Any, count: int, found: dict[str, np.ndarray]) -> None:
    """Fields of a device's state with one number an agent, those of features too; what is of before is left out."""
    for field, values in zip(getattr(state, "_fields", ()), state, strict=False):
        if isinstance(values, tuple):
            for part in (values,) if hasattr(values, "_fields") else values:
                _collect(part, count, found)
        elif getattr(values, "ndim", 0) == 2 and values.shape[1] == count and not field.endswith("_last_mhz"):
            found.setdefault(field, values)
