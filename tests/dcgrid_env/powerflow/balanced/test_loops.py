"""DistFlow of feeders with loops, against Newton's method and the equations of every bus and branch."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env import Feeder, FeederError, PowerFlowError, distflow, lindistflow, load_feeder
from dcgrid_env.powerflow import branch_loading, own_sensitivity, rated_nodes, rating_coverage, sensitivity
from dcgrid_env.powerflow.sensitivity import sensitivity_by
from helpers.looped import TIES, ieee33_with_ties, with_branches

TIGHT_KVA = 1e-9


def small(ends, r_ohm, x_ohm, p_kw, q_kvar, **columns):
    """A feeder of 1 kV, where ohm is per unit at 1 MVA, with buses 0, 1, ..."""
    return Feeder.from_tables(
        name="small", base_kv=1.0, substation=0, v0_pu=1.02, bus_ids=range(len(p_kw)), p_load_kw=p_kw,
        q_load_kvar=q_kvar, from_bus=[i for i, _ in ends], to_bus=[j for _, j in ends], r_ohm=r_ohm, x_ohm=x_ohm,
        **columns,
    )  # fmt: skip


def base(feeder):
    return feeder.p_load_kw, feeder.q_load_kvar - feeder.capacitor_kvar


def with_shunts_and_ratio(feeder):
    """A feeder with shunts at its buses, a part of it behind a transformer off its ratio, and all branches rated."""
    n = feeder.n_bus
    ratio = np.where(np.arange(n) > n // 2, 1.04, 1.0)
    return replace(
        feeder, shunt_kw=np.linspace(0.0, 5.0, n), shunt_kvar=np.linspace(0.0, 30.0, n), voltage_ratio=ratio,
        rating_a=np.linspace(50.0, 200.0, feeder.n_branch),
    )  # fmt: skip


@pytest.mark.parametrize(
    "feeder",
    [
        small([(0, 1), (1, 2), (2, 0)], [0.1, 0.2, 0.15], [0.2, 0.1, 0.3], [0, 300, 500], [0, 100, -200]),
        small(  # two loops that share a branch, one of two parallel branches, and a switch of no impedance
            [(0, 1), (1, 2), (2, 3), (1, 3), (3, 4), (4, 3)],
            [0.03, 0.04, 0.0, 0.08, 0.02, 0.05], [0.02, 0.05, 0.0, 0.02, 0.03, 0.01],
            [0, 200, 300, -700, 400], [0, 50, 100, 100, 90],
        ),
        *(ieee33_with_ties(n) for n in (1, 2, 5)),
        with_branches(load_feeder("khodr141"), [("27", "72", 0.3, 0.2), ("50", "110", 0.4, 0.3)]),
    ],
    ids=["one loop", "two loops", "ieee33, 1 tie", "ieee33, 2 ties", "ieee33, 5 ties", "khodr141, 2 ties"],
)  # fmt: skip
@pytest.mark.slow
def test_voltages_flows_and_loss_are_newtons(feeder, pandapower_net):
    p_kw, q_kvar = base(feeder)
    net = pandapower_net(replace(feeder, name=f"{feeder.name}, {feeder.n_branch} branches"))
    for scale, v0 in ((1.0, 1.0), (2.0, 1.05), (-0.7, 0.98)):
        newton = net.solve(scale * p_kw, scale * q_kvar, v0)
        solution = distflow(feeder, scale * p_kw, scale * q_kvar, v0, tolerance_kva=1e-6)
        assert solution.converged
        np.testing.assert_allclose(solution.v_pu, newton["v_pu"], rtol=0.0, atol=1e-8)
        np.testing.assert_allclose(solution.loss_kw, newton["loss_kw"], rtol=0.0, atol=1e-4)
        lines = net.net.res_line.p_from_mw.to_numpy() * 1000.0
        with_impedance = (feeder.r_ohm > 0) | (feeder.x_ohm > 0)
        np.testing.assert_allclose(solution.p_branch_kw[with_impedance], lines, rtol=0.0, atol=1e-3)


@pytest.mark.parametrize("scale", [3.0, 4.0, 6.0])
def test_voltages_close_to_collapse_are_newtons(scale, pandapower_net):
    feeder = replace(ieee33_with_ties(5), name="ieee33, 37 branches")
    p_kw, q_kvar = (scale * load for load in base(feeder))
    newton = pandapower_net(feeder).solve(p_kw, q_kvar, 1.0)
    solution = distflow(feeder, p_kw, q_kvar, 1.0)
    assert solution.converged
    assert newton["v_pu"].min() < {3.0: 0.85, 4.0: 0.79, 6.0: 0.6}[scale]
    np.testing.assert_allclose(solution.v_pu, newton["v_pu"], rtol=0.0, atol=1e-7)


@st.composite
def meshed(draw):
    """A random tree with up to eight further branches, shunts, and loads that it can carry."""
    n = draw(st.integers(3, 15))
    ends = [(draw(st.integers(0, j - 1)), j) for j in range(1, n)]
    further = st.tuples(st.integers(0, n - 1), st.integers(0, n - 1)).filter(lambda pair: pair[0] != pair[1])
    ends += draw(st.lists(further, min_size=1, max_size=8))
    z = st.floats(1e-4, 0.01)
    r, x = (draw(st.lists(z, min_size=len(ends), max_size=len(ends))) for _ in range(2))
    power = st.floats(-300.0, 600.0).map(lambda value: round(value, 9))  # no feeder has less than 1e-100 kW
    p, q, g, b = (draw(st.lists(power, min_size=n, max_size=n)) for _ in range(4))
    return small(ends, r, x, p, q, shunt_kw=[abs(value) / 10 for value in g], shunt_kvar=[value / 10 for value in b])


@given(meshed())
@settings(max_examples=80, deadline=None)
@pytest.mark.slow
def test_power_is_conserved_at_every_bus_and_voltages_agree_around_every_loop(feeder):
    s = distflow(feeder, *base(feeder), tolerance_kva=1e-8)
    assert s.converged
    r, x = feeder.r_pu, feeder.x_pu
    sent = (s.p_branch_kw + 1j * s.q_branch_kvar) / 1000.0
    received = sent - (r + 1j * x) * s.current_sq_pu
    v_sq = s.v_pu**2
    g_kw, b_kvar = (0.0 if kva is None else kva for kva in (feeder.shunt_kw, feeder.shunt_kvar))  # None: all are 0
    drawn = (feeder.p_load_kw + 1j * feeder.q_load_kvar + (g_kw - 1j * b_kvar) * v_sq) / 1000.0
    balance = -drawn
    np.add.at(balance, feeder.to_bus, received)
    np.subtract.at(balance, feeder.from_bus, sent)
    np.testing.assert_allclose(balance[1:], 0.0, rtol=0.0, atol=1e-9)
    source = -balance[0]
    np.testing.assert_allclose(source.real, drawn.real.sum() + s.loss_kw / 1000.0, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(s.loss_kw / 1000.0, (r * s.current_sq_pu).sum(), rtol=0.0, atol=1e-12)
    # Ohm's law of every branch with complex voltages: those of the tree follow from it, the others must fit.
    v = np.full(feeder.n_bus, 1.02 + 0.0j)
    for bus in feeder.depth_first.order[1:]:
        k, i = bus - 1, feeder.parent[bus - 1]
        v[bus] = v[i] - (r[k] + 1j * x[k]) * np.conj(sent[k] / v[i])
    np.testing.assert_allclose(np.abs(v), s.v_pu, rtol=0.0, atol=1e-9)
    drop = (r + 1j * x) * np.conj(sent / v[feeder.from_bus])
    np.testing.assert_allclose(v[feeder.from_bus] - v[feeder.to_bus], drop, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("n_row", [7, 40, 300])
def test_a_row_of_a_batch_has_the_bits_of_that_row_alone(n_row):
    feeder, rng = with_shunts_and_ratio(ieee33_with_ties(5)), np.random.default_rng(0)
    p_kw, q_kvar = (load * rng.uniform(-1.0, 3.0, (n_row, 33)) for load in base(feeder))
    p_kw[3] *= 50.0  # without a solution, which leaves the others alone
    v0 = rng.uniform(0.95, 1.05, n_row)
    many = distflow(feeder, p_kw, q_kvar, v0)
    assert many.converged.sum() == n_row - 1
    assert not many.converged[3]
    assert all(np.isfinite(figures).all() for figures in many[:5])
    again = distflow(feeder, p_kw, q_kvar, v0, warm=many)
    assert again.converged.sum() == n_row - 1
    assert (again.iterations <= many.iterations)[many.converged].all()
    for row in range(0, n_row, 3):
        for of, start in ((many, None), (again, many.restart[row])):
            one = distflow(feeder, p_kw[row], q_kvar[row], v0[row], warm=start)
            for a, b in zip(one, of, strict=True):
                np.testing.assert_array_equal(a, b[row])


def test_a_start_that_cannot_be_used_is_set_aside():
    feeder = ieee33_with_ties(2)
    cold = distflow(feeder, *base(feeder))
    assert distflow(feeder, *base(feeder), warm=cold).iterations <= 2
    for start in (np.full(34 + 4, np.nan), np.full(34 + 4, 1e9)):
        for a, b in zip(distflow(feeder, *base(feeder), warm=start), cold, strict=True):
            np.testing.assert_array_equal(a, b)
    with pytest.raises(PowerFlowError, match=r"warm start has shape \(34,\); for these loads it must be \(38,\)"):
        distflow(feeder, *base(feeder), warm=np.zeros(34))


@pytest.mark.parametrize("n_row", [1, 30])
def test_a_row_that_does_not_settle_is_reported(n_row):
    feeder = ieee33_with_ties(1)
    p_kw, q_kvar = (np.tile(load, (n_row, 1)) for load in base(feeder))
    few = distflow(feeder, p_kw, q_kvar, max_sweeps=3)
    assert not few.converged.any()
    assert (few.iterations == 3).all()
    assert all(np.isfinite(figures).all() for figures in few)
    p_kw[0, 5] = np.nan
    with pytest.raises(PowerFlowError, match="p_kw of bus 6 is nan in scenario"):
        distflow(feeder, p_kw, q_kvar)


def test_loads_of_float32_give_figures_of_float32():
    feeder = ieee33_with_ties(5)
    p_kw, q_kvar = (np.tile(load, (20, 1)) for load in base(feeder))
    single = distflow(feeder, p_kw.astype(np.float32), q_kvar.astype(np.float32))
    assert single.converged.all()
    assert {figures.dtype.name for figures in single} == {"float32", "bool", "int64"}
    np.testing.assert_allclose(single.v_pu, distflow(feeder, p_kw, q_kvar).v_pu, rtol=0.0, atol=1e-6)
    assert distflow(feeder, *(load.astype(np.float32) for load in base(feeder))).v_pu.dtype == np.float32


@pytest.mark.parametrize("n_tie", [1, 2, 5])
@pytest.mark.parametrize("load", [0.5, 3.0, -1.0])
def test_the_derivative_is_that_of_finite_differences(n_tie, load):
    feeder, rng = with_shunts_and_ratio(ieee33_with_ties(n_tie)), np.random.default_rng(1)
    loads = [load * values * rng.uniform(0.5, 1.5, (3, 33)) for values in base(feeder)]
    given_by = [*loads, np.array([1.0, 1.03, 0.98])]
    sizes = (1000.0, 0.1, 0.1, 1.0, 1.0)

    def solved(values):
        return distflow(feeder, *values, tolerance_kva=TIGHT_KVA)[:5]

    weights = [size * rng.normal(size=a.shape) for size, a in zip(sizes, solved(given_by), strict=True)]
    tensors = [torch.tensor(values, requires_grad=True) for values in given_by]
    total = sum((torch.tensor(w) * a).sum() for w, a in zip(weights, solved(tensors), strict=True))
    total.backward()  # pyright: ignore[reportAttributeAccessIssue]
    for i, (tensor, step) in enumerate(zip(tensors, (0.1, 0.1, 1e-5), strict=True)):
        direction = rng.normal(size=given_by[i].shape)
        ends = []
        for sign in (1.0, -1.0):
            moved = [values + sign * step * direction if j == i else values for j, values in enumerate(given_by)]
            ends.append(sum(float((w * a).sum()) for w, a in zip(weights, solved(moved), strict=True)))
        assert tensor.grad is not None
        ours = float((tensor.grad.numpy() * direction).sum())
        assert ours == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-6)


def test_a_row_without_a_solution_has_no_derivative():
    feeder = ieee33_with_ties(2)
    p_kw, q_kvar = (np.tile(load, (2, 1)) for load in base(feeder))
    p_kw[1] *= 100.0
    p, q = torch.tensor(p_kw, requires_grad=True), torch.tensor(q_kvar, requires_grad=True)
    distflow(feeder, p, q).v_pu.sum().backward()
    assert p.grad is not None
    assert (p.grad[1] == 0).all()
    assert (p.grad[0, 1:] < 0).all()


def test_tensors_give_the_figures_of_arrays():
    feeder = with_shunts_and_ratio(ieee33_with_ties(5))
    p_kw, q_kvar = base(feeder)
    ours = distflow(feeder, p_kw, q_kvar)
    for a, b in zip(distflow(feeder, torch.tensor(p_kw), torch.tensor(q_kvar)), ours, strict=True):
        np.testing.assert_array_equal(a.numpy(), b)


def test_sensitivities_are_the_derivatives_without_load():
    feeder = replace(ieee33_with_ties(5), voltage_ratio=np.where(np.arange(33) > 20, 1.04, 1.0))
    by_all, buses = sensitivity(feeder), [5, 17, 32]
    for matrix, columns, own in zip(by_all, sensitivity_by(feeder, buses), own_sensitivity(feeder), strict=True):
        np.testing.assert_allclose(columns, matrix[:, buses].T, rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(own, np.diagonal(matrix), rtol=0.0, atol=1e-14)
    for bus in buses:
        one, none = 0.5 * (np.arange(33) == bus), np.zeros(33)
        for matrix, (p_kw, q_kvar) in zip(by_all, ((one, none), (none, one)), strict=True):
            up, down = (distflow(feeder, s * p_kw, s * q_kvar, 1.0, tolerance_kva=TIGHT_KVA).v_pu for s in (-1, 1))
            np.testing.assert_allclose(1000.0 * (up - down), matrix[:, bus], rtol=0.0, atol=1e-6 * matrix.max())


def test_closing_branches_have_loadings_ratings_and_names():
    feeder = ieee33_with_ties(5, rating_a=150.0)
    assert (feeder.n_bus, feeder.n_branch, feeder.n_loop) == (33, 37, 5)
    assert str(rating_coverage(feeder)) == "ratings known for 37 of 37 elements"
    solution = distflow(feeder, *base(feeder))
    loading = branch_loading(feeder, solution)
    assert loading.shape == (38,)
    assert rated_nodes(feeder).tolist() == list(range(1, 38))
    current_a = np.sqrt(solution.current_sq_pu) * 1000.0 / (np.sqrt(3.0) * feeder.base_kv)
    np.testing.assert_allclose(loading[1:], current_a / 150.0, rtol=1e-6)
    assert loading[33:].min() > 0.005
    one_unknown = replace(feeder, rating_a=np.where(np.arange(37) == 35, np.nan, 150.0))
    assert rating_coverage(one_unknown).not_checked == (feeder.branch_names[35],)
    ties = {frozenset(name.split(" ")[1].split("-")) for name in feeder.branch_names[32:]}
    assert frozenset(("18", "33")) in ties
    assert len(TIES) == len(ties)


def test_what_does_not_solve_loops_refuses_them():
    feeder = ieee33_with_ties(2)
    with pytest.raises(FeederError, match="'ieee33' has 2 loops, which LinDistFlow does not solve; solve by distflow"):
        lindistflow(feeder, *base(feeder))
    load = torch.zeros(33, device="meta")
    with pytest.raises(FeederError, match="'ieee33' has 2 loops, which are not solved on meta; give NumPy arrays or"):
        distflow(feeder, load, load, torch.ones((), device="meta"))
    with pytest.raises(FeederError, match=r"loop_ends has shape \(1, 2\); give the two buses of each of the 2"):
        replace(feeder, loop_ends=np.array([[1, 2]]))
