"""Properties of every solution, on random trees: the DistFlow equations, derived again from the tables.

The residuals here know the feeder only by its tables: buses shuffled, branches turned, a quarter of them switches.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env import Feeder, Solution, distflow, lindistflow
from dcgrid_env.powerflow.balanced import implicit, prefix

TOLERANCE_KVA = 1e-8
CLOSE = 1e-9  # p.u., of the equations below


@dataclass(frozen=True)
class Case:
    """A tree over buses 0 (the substation) .. n - 1 and its load; 1 kV and 1 MVA, so ohm is per unit."""

    up: dict[int, int]  # bus -> the bus that feeds it
    r: dict[int, float]  # bus -> impedance of the branch that feeds it
    x: dict[int, float]
    p: np.ndarray  # per unit, by bus
    q: np.ndarray
    v0: float
    feeder: Feeder

    def loads(self) -> tuple[np.ndarray, np.ndarray]:
        """kW and kvar in the order of the feeder's bus_ids."""
        order = list(self.at())
        return 1000.0 * self.p[order], 1000.0 * self.q[order]

    def at(self) -> dict[int, int]:
        """Position in the feeder's bus_ids of each bus, in their order."""
        return {int(bus): i for i, bus in enumerate(self.feeder.bus_ids)}

    def below(self, bus: int) -> Iterator[int]:
        return (j for j, i in self.up.items() if i == bus)


@st.composite
def cases(draw: Any, *, most_drop: float, switches: bool = True, least: float = 1e-4) -> Case:
    """Trees of 2 to 30 buses, scaled so that no voltage drops or rises by more than about ``most_drop``."""
    ohm = st.floats(least, 0.05)
    impedance = st.tuples(ohm, ohm)
    if switches:
        impedance = st.one_of(impedance, impedance, impedance, st.just((0.0, 0.0)))
    load = st.floats(-1.0, 1.0, allow_subnormal=False)
    rows = draw(st.lists(st.tuples(st.integers(0, 29), impedance, load, load, st.booleans()), min_size=1, max_size=29))
    n = len(rows) + 1
    up = {k + 1: row[0] % (k + 1) for k, row in enumerate(rows)}
    r = {k + 1: row[1][0] for k, row in enumerate(rows)}
    x = {k + 1: row[1][1] for k, row in enumerate(rows)}
    p = np.array([draw(load), *(row[2] for row in rows)])
    q = np.array([draw(load), *(row[3] for row in rows)])
    through = np.hypot(p, q)
    for bus in range(n - 1, 0, -1):
        through[up[bus]] += through[bus]
    drop = np.zeros(n)
    for bus in range(1, n):
        drop[bus] = drop[up[bus]] + np.hypot(r[bus], x[bus]) * through[bus]
    scale = min(1.0, most_drop / max(drop.max(), 1e-12))
    names = draw(st.permutations(range(n)))
    ends = [(bus, up[bus]) if turned else (up[bus], bus) for bus, (*_, turned) in enumerate(rows, start=1)]
    feeder = Feeder.from_tables(
        name="random", base_kv=1.0, substation=0, v0_pu=1.0, bus_ids=names, p_load_kw=[0.0] * n,
        q_load_kvar=[0.0] * n, from_bus=[i for i, _ in ends], to_bus=[j for _, j in ends],
        r_ohm=[r[bus] for bus in range(1, n)], x_ohm=[x[bus] for bus in range(1, n)],
    )  # fmt: skip
    return Case(up, r, x, scale * p, scale * q, draw(st.floats(0.95, 1.05)), feeder)


def solve(case: Case, kind: str, method: Any = distflow, **options: Any) -> Solution:
    loads = case.loads()
    if kind == "numpy":
        return method(case.feeder, *loads, case.v0, **options)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(implicit, "distflow_tensors", prefix.distflow_arrays)
        return Solution(*(a.numpy() for a in method(case.feeder, *map(torch.tensor, loads), case.v0, **options)))


@pytest.mark.parametrize("kind", ["numpy", "arrays"])
@settings(deadline=None)
@given(case=cases(most_drop=0.1))
@pytest.mark.slow
def test_the_solution_fulfils_the_distflow_equations(kind, case):
    solution = solve(case, kind, tolerance_kva=TOLERANCE_KVA)
    assert solution.converged
    assert solution.residual_kva <= TOLERANCE_KVA
    at = case.at()
    v = {bus: solution.v_pu[at[bus]] ** 2 for bus in at}
    P = {bus: solution.p_branch_kw[at[bus] - 1] / 1000.0 for bus in case.up}
    Q = {bus: solution.q_branch_kvar[at[bus] - 1] / 1000.0 for bus in case.up}
    l = {bus: solution.current_sq_pu[at[bus] - 1] for bus in case.up}
    assert solution.v_pu[0] == pytest.approx(case.v0, abs=1e-15)
    for j, i in case.up.items():
        r, x = case.r[j], case.x[j]
        assert abs(P[j] - (case.p[j] + r * l[j] + sum(P[k] for k in case.below(j)))) < CLOSE
        assert abs(Q[j] - (case.q[j] + x * l[j] + sum(Q[k] for k in case.below(j)))) < CLOSE
        assert abs(v[j] - (v[i] - 2.0 * (r * P[j] + x * Q[j]) + (r * r + x * x) * l[j])) < CLOSE
        assert abs(l[j] * v[i] - (P[j] ** 2 + Q[j] ** 2)) < CLOSE * max(1.0, l[j])
        if r == x == 0.0:
            assert abs(v[j] - v[i]) < 1e-14
    loss = sum(case.r[j] * l[j] for j in case.up)
    assert abs(solution.loss_kw / 1000.0 - loss) < CLOSE
    imported = case.p[0] + sum(P[k] for k in case.below(0))
    assert abs(imported - (case.p.sum() + loss)) < len(case.up) * CLOSE
    imported = case.q[0] + sum(Q[k] for k in case.below(0))
    assert abs(imported - (case.q.sum() + sum(case.x[j] * l[j] for j in case.up))) < len(case.up) * CLOSE


@settings(deadline=None)
@given(case=cases(most_drop=0.1))
@pytest.mark.slow
def test_complex_voltages_and_currents_carry_the_same_power(case):
    # Away from DistFlow's squares: walk down with phasors, current = conj(S / V), and meet each load at its bus.
    solution = solve(case, "numpy", tolerance_kva=TOLERANCE_KVA)
    at = case.at()
    voltage, current = {0: complex(case.v0)}, {}
    for j in sorted(case.up):  # a bus is numbered after the one that feeds it
        sent = (solution.p_branch_kw[at[j] - 1] + 1j * solution.q_branch_kvar[at[j] - 1]) / 1000.0
        current[j] = (sent / voltage[case.up[j]]).conjugate()
        voltage[j] = voltage[case.up[j]] - complex(case.r[j], case.x[j]) * current[j]
    for j in case.up:
        drawn = voltage[j] * (current[j] - sum(current[k] for k in case.below(j))).conjugate()
        assert abs(drawn - complex(case.p[j], case.q[j])) < 1e-8
        assert abs(abs(voltage[j]) - solution.v_pu[at[j]]) < 1e-8


@settings(deadline=None)
@given(case=cases(most_drop=0.05, switches=False, least=0.01), data=st.data())
@pytest.mark.slow
def test_more_load_at_a_bus_lowers_its_voltage(case, data):
    bus = data.draw(st.sampled_from(sorted(case.up)))
    i = case.feeder.index(bus)
    p_kw, q_kvar = case.loads()
    more = np.zeros(case.feeder.n_bus)
    more[i] = 5.0
    loads = np.stack([p_kw, p_kw + more, p_kw]), np.stack([q_kvar, q_kvar, q_kvar + more])
    solution = distflow(case.feeder, *loads, case.v0)
    assert solution.converged.all()
    before, more_p, more_q = solution.v_pu[:, i]
    assert more_p < before
    assert more_q < before


@pytest.mark.parametrize("kind", ["numpy", "arrays"])
@settings(deadline=None)
@given(case=cases(most_drop=0.1))
@pytest.mark.slow
def test_lindistflow_adds_loads_and_drops_along_the_tree(kind, case):
    solution = solve(case, kind, lindistflow)
    assert solution.converged
    at = case.at()
    for j, i in case.up.items():
        P, Q = solution.p_branch_kw[at[j] - 1] / 1000.0, solution.q_branch_kvar[at[j] - 1] / 1000.0
        assert abs(P - case.p[j] - sum(solution.p_branch_kw[at[k] - 1] / 1000.0 for k in case.below(j))) < 1e-12
        assert abs(Q - case.q[j] - sum(solution.q_branch_kvar[at[k] - 1] / 1000.0 for k in case.below(j))) < 1e-12
        drop = solution.v_pu[at[i]] ** 2 - solution.v_pu[at[j]] ** 2
        assert abs(drop - 2.0 * (case.r[j] * P + case.x[j] * Q)) < 1e-12


@settings(deadline=None)
@given(case=cases(most_drop=0.1))
@pytest.mark.slow
def test_losses_lower_voltages_where_no_power_is_fed_in(case):
    # With loads alone, DistFlow's voltages lie below LinDistFlow's, which knows no losses.
    p_kw, q_kvar = (np.abs(load) for load in case.loads())
    exact = distflow(case.feeder, p_kw, q_kvar, case.v0, tolerance_kva=TOLERANCE_KVA)
    linear = lindistflow(case.feeder, p_kw, q_kvar, case.v0)
    assert exact.converged
    assert (exact.v_pu <= linear.v_pu + CLOSE).all()
    assert exact.loss_kw >= 0.0
