"""The command ``python -m docs.studies roofline``: what limits a batch of power flows.

Rates are per second of processor time, so other work on the machine hardly changes them. Ceilings are measured on one
thread: multiplications and additions of values in registers, and the triad
a = b + s c (J. D. McCalpin, "Memory bandwidth and machine balance in current high performance computers", 1995) on
arrays that fit into the second-level cache and on arrays that do not. The model is that of S. Williams, A. Waterman and
D. Patterson, "Roofline", Communications of the ACM 52(4), 2009.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from time import process_time
from typing import Any

import numba
import numpy as np

from dcgrid_env import make_scenario
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.settings import at_least
from dcgrid_env.core.threads import n_threads
from dcgrid_env.powerflow import distflow, solve_unbalanced
from dcgrid_env.powerflow.balanced.compiled_blocks import BLOCK
from dcgrid_env.powerflow.unbalanced.sweep_rows import WIDE
from docs.studies.speed.measuring import ROOT, rate
from docs.studies.speed.operation_counts import BALANCED, THREE_PHASE
from docs.studies.speed.power_flow_rates import Case
from docs.studies.speed.three_phase_rates import ThreePhaseCase

FIGURE = 8
"""Bytes of a float64."""
IN_CACHE, IN_MEMORY, IN_REGISTERS = 12_000, 8_000_000, 64
"""Elements of an array: together the triad's have 288 kB, a block's size, or 192 MB."""
DEGREE = 32


@numba.njit(error_model="numpy")
def _polynomial(x: np.ndarray, factor: float, repeats: int) -> None:
    """Multiply and add DEGREE times to each element, with no operation fused, as the power flow must not."""
    for _ in range(repeats):
        for b in range(x.shape[0]):
            y = x[b]
            for _ in range(DEGREE):
                y = y * factor + factor
            x[b] = y


@numba.njit(error_model="numpy")
def _triad(a: np.ndarray, b: np.ndarray, c: np.ndarray, factor: float, repeats: int) -> None:
    for _ in range(repeats):
        for i in range(a.shape[0]):
            a[i] = b[i] + factor * c[i]


@dataclass(frozen=True)
class Ceilings:
    """What one core of this machine does at most."""

    flops_per_s: float
    cache_bytes_per_s: float
    memory_bytes_per_s: float


def ceilings(seconds: float) -> Ceilings:
    """Measure them, ``seconds`` each."""
    x = np.ones(IN_REGISTERS)
    flops = rate(lambda: _polynomial(x, 0.5, 10_000), 2.0 * DEGREE * IN_REGISTERS * 10_000, seconds, process_time)

    def triad(size: int, repeats: int) -> float:
        a, b, c = (np.ones(size) for _ in range(3))
        return rate(lambda: _triad(a, b, c, 0.5, repeats), 3.0 * FIGURE * size * repeats, seconds, process_time)

    return Ceilings(flops, triad(IN_CACHE, 1_000), triad(IN_MEMORY, 1))


def counts_per_sweep() -> dict[str, dict[str, int]]:
    """Count in a separate process, where the kernels are not compiled."""
    command = [sys.executable, "-m", "docs.studies.speed.operation_counts"]
    done = subprocess.run(
        command, env=os.environ | {"NUMBA_DISABLE_JIT": "1"}, cwd=ROOT, capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


def block_sweeps(iterations: np.ndarray, width: int) -> float:
    """Mean sweeps of a row: those of a block of ``width`` rows end with its last row."""
    return float(np.mean([iterations[first : first + width].max() for first in range(0, len(iterations), width)]))


def moved_bytes(given: tuple[np.ndarray, ...], solution: Any) -> int:
    """Bytes of the inputs and the results of a batch, which each pass through memory once."""
    wholes = (part if part.base is None else part.base for part in solution if isinstance(part, np.ndarray))
    results = {id(whole): whole for whole in wholes}
    return sum(part.nbytes for part in (*given, *results.values()))


@dataclass(frozen=True)
class Roofline(Command):
    """Compare two batched power flows with what one core can do.

    The table has floating-point operations and bytes of a flow, and their rates in shares of the machine's. Operations
    and array accesses are counted from the source of the kernels; the compiler keeps some of the accesses in registers.
    """

    points: int = 4096
    """Power flows of a batch, from a cold start."""
    seconds: float = 2.0
    """Seconds for each measurement."""

    def run(self) -> None:
        """Measure and print. ValueError for an invalid setting."""
        at_least(self, points=64)
        if not self.seconds > 0.0:
            raise ValueError(f"seconds: must be positive, got {self.seconds}")
        if n_threads() != 1:
            raise ValueError(f"DCGRID_NUM_THREADS: this study is for one thread, got {n_threads()}; set it to 1")
        most = ceilings(self.seconds)
        print(
            f"One core: {most.flops_per_s / 1e9:.1f} Gflop/s, {most.cache_bytes_per_s / 1e9:.0f} GB/s from the cache, "
            f"{most.memory_bytes_per_s / 1e9:.1f} GB/s from memory.\n"
        )
        heads = ["power flow", "flows/s", "sweeps", "flops", "divisions and roots", "bytes in cache", "bytes of memory"]
        print(f"| {' | '.join([*heads, 'arithmetic, %', 'cache, %', 'memory, %'])} |")
        print("|---" + "|---:" * (len(heads) + 2) + "|")
        counts = counts_per_sweep()
        balanced, three = Case.draw(make_scenario(BALANCED), self.points), ThreePhaseCase.draw(self.points)
        loads, legs = (balanced.p_kw, balanced.q_kvar), (three.p_kw, three.q_kvar)
        flows: dict[str, tuple[tuple[np.ndarray, ...], int, Callable[[], Any]]] = {
            BALANCED: (loads, BLOCK, lambda: distflow(balanced.feeder, *loads, balanced.v0_pu)),
            THREE_PHASE: (legs, len(WIDE), lambda: solve_unbalanced(three.feeder, *legs, None, three.control)),
        }
        for name, (given, width, solve) in flows.items():
            print(self._line(name, counts[name], given, width, solve, most))

    def _line(
        self,
        name: str,
        per_sweep: dict[str, int],
        given: tuple[np.ndarray, ...],
        width: int,
        solve: Callable[[], Any],
        most: Ceilings,
    ) -> str:
        solution = solve()
        sweeps, moved = block_sweeps(solution.iterations, width), moved_bytes(given, solution) / self.points
        per_s = rate(solve, self.points, self.seconds, process_time)
        flops, in_cache = sweeps * per_sweep["flops"], sweeps * FIGURE * per_sweep["accesses"]
        amounts = (flops, sweeps * per_sweep["divisions and roots"], in_cache, moved)
        shares = (
            flops * per_s / most.flops_per_s,
            in_cache * per_s / most.cache_bytes_per_s,
            moved * per_s / most.memory_bytes_per_s,
        )
        cells = [f"`{name}`", f"{per_s:,.0f}", f"{sweeps:.1f}", *(f"{amount:,.0f}" for amount in amounts)]
        return f"| {' | '.join([*cells, *(f'{100.0 * share:.0f}' for share in shares)])} |"
