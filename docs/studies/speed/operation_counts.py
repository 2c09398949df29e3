"""Floating-point operations and array accesses of a sweep, counted by running the kernels' source in Python.

``python -m docs.studies.speed.operation_counts`` prints them as JSON. It needs NUMBA_DISABLE_JIT=1, under which the
kernels are ordinary functions.
"""

from __future__ import annotations

import json
import math
import os
from collections import Counter
from typing import Any

import numpy as np

from dcgrid_env.grid import load_feeder
from dcgrid_env.powerflow.balanced import compiled_blocks
from dcgrid_env.powerflow.balanced.batch import constants
from dcgrid_env.powerflow.unbalanced.plan import plan_of
from dcgrid_env.powerflow.unbalanced.row_blocks import begin, load_row, sweep_block, workspace

BALANCED, THREE_PHASE = "ieee123", "ieee123-3ph"
ONE = (0,)
"""A block of one row."""


class Figure:
    """A number of a row, whose operations are counted. Constants of the feeder are ordinary numbers."""

    __array_priority__ = 1000.0  # NumPy's numbers leave operations to it
    __slots__ = ("counts", "value")

    def __init__(self, value: float, counts: Counter[str]) -> None:
        self.value, self.counts = value, counts

    def _operation(self, value: float) -> Figure:
        self.counts["flops"] += 1
        return Figure(value, self.counts)

    def __add__(self, other: Any) -> Figure:
        return self._operation(self.value + float(other))

    def __sub__(self, other: Any) -> Figure:
        return self._operation(self.value - float(other))

    def __rsub__(self, other: Any) -> Figure:
        return self._operation(float(other) - self.value)

    def __mul__(self, other: Any) -> Figure:
        return self._operation(self.value * float(other))

    def __truediv__(self, other: Any) -> Figure:
        self.counts["divisions and roots"] += 1
        return self._operation(self.value / float(other))

    def __rtruediv__(self, other: Any) -> Figure:
        self.counts["divisions and roots"] += 1
        return self._operation(float(other) / self.value)

    __radd__, __rmul__ = __add__, __mul__

    def sqrt(self) -> Figure:
        """Return the root; NumPy calls this."""
        self.counts["divisions and roots"] += 1
        return self._operation(math.sqrt(self.value))

    def __neg__(self) -> Figure:
        return Figure(-self.value, self.counts)  # a sign is no operation of its own

    def __abs__(self) -> Figure:
        return Figure(abs(self.value), self.counts)

    def __float__(self) -> float:
        return self.value

    def __lt__(self, other: Any) -> bool:
        return self.value < float(other)

    def __le__(self, other: Any) -> bool:
        return self.value <= float(other)

    def __gt__(self, other: Any) -> bool:
        return self.value > float(other)

    def __ge__(self, other: Any) -> bool:
        return self.value >= float(other)


class Figures:
    """An array of a block whose accesses are counted."""

    def __init__(self, values: np.ndarray, counts: Counter[str]) -> None:
        self.values, self.counts = values, counts

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the array's dimensions."""
        return self.values.shape

    def __getitem__(self, place: Any) -> Figure:
        self.counts["accesses"] += 1
        return Figure(float(self.values[place]), self.counts)

    def __setitem__(self, place: Any, value: Any) -> None:
        self.counts["accesses"] += 1
        self.values[place] = float(value)


def balanced_counts(name: str = BALANCED) -> Counter[str]:
    """Count what a DistFlow sweep of one feeder does in a block of many."""
    feeder, counts = load_feeder(name), Counter()
    _, parent, r, x, shunt_g, shunt_b, _ = constants(feeder, np.float64)
    n = feeder.n_bus
    compiled_blocks.BLOCK = 1
    p, q, P, Q, l = (Figures(np.full((n, 1), 1e-3), counts) for _ in range(5))
    v, before = Figures(np.ones((n, 1)), counts), Figures(np.ones((len(shunt_g), 1)), counts)
    off, v_up = (Figures(np.ones(1), counts) for _ in range(2))
    tree = compiled_blocks._tree(parent)
    compiled_blocks._sweep(tree, r, x, shunt_g, shunt_b, p, q, P, Q, v, l, before, off, v_up)
    return counts


def three_phase_counts(name: str = THREE_PHASE) -> Counter[str]:
    """Count what a three-phase sweep of one feeder at its base load does in a block of many."""
    feeder, counts = load_feeder(name), Counter()
    plan, controls = plan_of(feeder), (feeder.tap_ratio(feeder.base_tap)[None], np.ones((1, feeder.n_capacitor)))
    given = (feeder.p_load_kw[None], feeder.q_load_kvar[None], np.array([feeder.v0_pu]), *controls)
    work = workspace(plan, None, ONE, given)
    nodes = np.empty(0, np.uint64)
    load_row(0, 0, plan, ONE, given, nodes, 0, work)
    begin(plan, None, ONE, work)
    sweep_block(plan, None, ONE, nodes, 0, tuple(Figures(part, counts) for part in work))
    return counts


if __name__ == "__main__":
    assert os.environ.get("NUMBA_DISABLE_JIT") == "1", "set NUMBA_DISABLE_JIT=1"
    print(json.dumps({BALANCED: balanced_counts(), THREE_PHASE: three_phase_counts()}))
