"""Near the largest load that a feeder can carry, where Newton's method takes the place of the sweep."""

from typing import Any

import numpy as np
import pytest
import torch

from dcgrid_env import load_feeder
from dcgrid_env.powerflow import Control, solve_unbalanced
from dcgrid_env.powerflow.unbalanced import adjoint_batch, newton
from dcgrid_env.powerflow.unbalanced.newton import high_voltage_solution
from docs.studies.speed.opendss_circuit import OpenDss
from helpers.feeders import THREE_PHASE

SHARES = (0.9, 0.963, 0.98, 0.99, 0.999, 0.9999)
"""Of the largest load."""
BEYOND = 1.005
V_PU = 1e-7


def grounded(feeder):
    """Nodes, except those behind a delta, where OpenDSS has no ground."""
    table = feeder.network.transformer
    deltas = [bus for bus, winding in zip(table.to_bus, table.connection_to, strict=True) if winding == "delta"]
    return np.array([n for n in range(3, feeder.n_node) if feeder.bus_ids[feeder.node_bus[n]] not in deltas])


def growing(feeder, seed):
    """One power flow by the size of a load that grows, at all nodes or at one; other taps and capacitors for seed 1."""
    rng, nodes = np.random.default_rng(seed), grounded(feeder)
    added = np.zeros(feeder.n_leg)
    added[feeder.first_device_leg + (nodes if seed == 0 else rng.choice(nodes))] = 1.0
    tap = np.clip(feeder.base_tap + rng.integers(-3, 4, feeder.n_regulator), -16, 16) if seed else feeder.base_tap
    state = rng.integers(0, 2, feeder.n_capacitor).astype(float) if seed else feeder.base_capacitor_on

    def given(size):
        p_kw, q_kvar = feeder.p_load_kw + size * added, feeder.q_load_kvar + 0.3 * size * added
        return p_kw, q_kvar, feeder.v0_pu, feeder.tap_ratio(tap), state

    return given


def largest(given, feeder):
    """The largest size that has a solution, kW, by halves."""
    low, high = 0.0, 20000.0
    for _ in range(28):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if high_voltage_solution(feeder, given(middle)) is not None else (low, middle)
    return low


def solved(feeder, points, **options):
    p_kw, q_kvar, source_pu, ratio, state = (np.array(a) for a in zip(*points, strict=True))
    return solve_unbalanced(feeder, p_kw, q_kvar, source_pu, Control(tap_ratio=ratio, capacitor_on=state), **options)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", THREE_PHASE)
def test_cold_and_warm_starts_find_what_opendss_finds(name, seed):
    pytest.importorskip("dss", reason="OpenDSSDirect.py is not installed (the extra test has it)")
    feeder = load_feeder(name)
    given = growing(feeder, seed)
    most = largest(given, feeder)
    points = [given(share * most) for share in (*SHARES, BEYOND)]
    cold = solved(feeder, points)
    assert cold.converged.tolist() == [True] * len(SHARES) + [False]
    near = solved(feeder, [given((share - 1e-4) * most) for share in (*SHARES, BEYOND)])
    warm = solved(feeder, points, start=near)
    assert warm.converged.tolist() == cold.converged.tolist()
    np.testing.assert_allclose(warm.v_pu[:-1], cold.v_pu[:-1], rtol=0.0, atol=V_PU)
    circuit = OpenDss(feeder)
    circuit.dss.Text.Command = "Set MaxIterations=3000"
    v_pu = cold.v_re_pu + 1j * cold.v_im_pu
    for k, point in enumerate(points[:-1]):
        theirs, loss_kw, p_kw, q_kvar = circuit.solve(*point)
        np.testing.assert_allclose(v_pu[k], theirs, rtol=0.0, atol=V_PU, err_msg=f"at {SHARES[k]}")
        assert (cold.loss_kw[k], cold.source_p_kw[k], cold.source_q_kvar[k]) == pytest.approx(
            (loss_kw, p_kw, q_kvar), abs=1e-2
        )
    with pytest.raises(RuntimeError, match="OpenDSS found no power flow"):
        circuit.solve(*points[-1])


def test_loads_that_become_impedances_have_no_limit():
    # Below their lowest voltage the loads' currents fall with it: OpenDSS converges, the sweep alone does not.
    feeder = load_feeder("ieee13-3ph")
    p_kw, q_kvar = 8.0 * feeder.p_load_kw, 8.0 * feeder.q_load_kvar
    solution = solve_unbalanced(feeder, p_kw, q_kvar)
    assert solution.converged
    circuit = OpenDss(feeder)
    theirs = circuit.solve(p_kw, q_kvar, feeder.v0_pu, feeder.tap_ratio(feeder.base_tap), feeder.base_capacitor_on)[0]
    np.testing.assert_allclose(solution.v_re_pu + 1j * solution.v_im_pu, theirs, rtol=0.0, atol=1e-6)


def test_newton_is_the_sweep_where_that_settles_and_is_not_used_there(feeder, random_inputs, solved, monkeypatch):
    inputs = random_inputs(feeder, 6, 60)
    swept = solved(feeder, inputs, tolerance_pu=1e-12)
    for row in range(6):
        volts: Any = high_voltage_solution(feeder, tuple(a[row] for a in inputs))
        np.testing.assert_allclose(volts, swept.restart[row], rtol=0.0, atol=1e-11)
    monkeypatch.setattr(newton, "high_voltage_solution", None)
    assert solved(feeder, inputs).converged.all()


@pytest.mark.slow
def test_each_environment_of_a_batch_that_needs_it_has_the_bits_that_it_has_alone():
    feeder = load_feeder("ieee34-3ph")
    given = growing(feeder, 0)
    points = [given(size) for size in (1.0, 36.5, 2.0, 36.8, 40.0) * 9]
    whole = solved(feeder, points)
    assert whole.converged.tolist() == [True, True, True, True, False] * 9
    assert (whole.iterations[1::5] == 1).all()
    assert (whole.residual_kva[1::5] < 5e-6).all()
    for row in (0, 1, 3, 4):
        alone = solved(feeder, points[row : row + 1])
        for figures, of_row in zip(whole, alone, strict=True):
            assert figures[row].tobytes() == of_row[0].tobytes()
    p_kw, q_kvar = (torch.tensor(np.array([point[k] for point in points])) for k in (0, 1))
    tensors: Any = solve_unbalanced(feeder, p_kw, q_kvar)
    np.testing.assert_array_equal(tensors.v_pu.numpy(), whole.v_pu)


def test_it_takes_smaller_steps_where_the_whole_load_at_once_fails(monkeypatch):
    feeder = load_feeder("ieee34-3ph")
    given = growing(feeder, 0)(30.0)
    whole: Any = high_voltage_solution(feeder, given)
    taken, tried = newton._newton, []

    def fails_beyond_a_quarter(equations, x, share, sign):
        tried.append(share)
        return taken(equations, x, share, sign) if len(tried) > 2 else None

    monkeypatch.setattr(newton, "_newton", fails_beyond_a_quarter)
    again: Any = high_voltage_solution(feeder, given)
    np.testing.assert_allclose(again, whole, rtol=0.0, atol=1e-11)
    assert tried == [1.0, 0.5, 0.25, 0.5, 0.75, 1.0]


def test_derivatives_where_the_sweep_does_not_settle():
    feeder = load_feeder("ieee34-3ph")
    given = growing(feeder, 0)(36.5)
    rng = np.random.default_rng(0)
    names = ("v_pu", "v_re_pu", "i_im_a", "loss_kw", "source_p_kw", "source_q_kvar")
    weights = {name: rng.normal(size=feeder.n_node if name[0] in "vi" else ()) for name in names}

    def weighted(arrays, kind) -> Any:
        p_kw, q_kvar, source_pu, ratio, state = arrays
        solution = solve_unbalanced(feeder, p_kw, q_kvar, source_pu, Control(tap_ratio=ratio, capacitor_on=state))
        assert solution.converged
        return sum((getattr(solution, name) * kind(weight)).sum() for name, weight in weights.items())

    state = np.full(feeder.n_capacitor, 0.7)
    arrays = tuple(np.array(a) for a in (*given[:4], state))
    tensors = tuple(torch.tensor(a, requires_grad=True) for a in arrays)
    found = torch.autograd.grad(weighted(tensors, torch.tensor), tensors)
    for by, h in enumerate((1e-3, 1e-3, 1e-6, 1e-6, 1e-5)):
        direction = rng.normal(size=arrays[by].shape)
        moved = [tuple(a + s * h * direction if k == by else a for k, a in enumerate(arrays)) for s in (1.0, -1.0)]
        slope = (weighted(moved[0], np.asarray) - weighted(moved[1], np.asarray)) / (2.0 * h)
        assert float((found[by] * torch.tensor(direction)).sum()) == pytest.approx(slope, rel=1e-4)


def test_newtons_derivative_is_the_sweeps_where_that_settles(feeder, random_inputs, solved, monkeypatch):
    inputs, rng = random_inputs(feeder, 3, 61), np.random.default_rng(1)
    weights = [rng.normal(size=(3, feeder.n_node)) for _ in range(4)] + [rng.normal(size=3) for _ in range(3)]

    def derivatives():
        given = type(inputs)(*(torch.tensor(a, requires_grad=True) for a in inputs))
        s = solved(feeder, given, tolerance_pu=1e-13)
        figures = (s.v_pu, s.v_re_pu, s.i_re_a, s.i_im_a, s.loss_kw, s.source_p_kw, s.source_q_kvar)
        total: Any = sum((f * torch.tensor(w)).sum() for f, w in zip(figures, weights, strict=True))
        return torch.autograd.grad(total, given)

    swept = derivatives()
    monkeypatch.setattr(adjoint_batch, "sweep_adjoint_rows", lambda *given: given[8].fill(False) or 0)
    for one, two in zip(derivatives(), swept, strict=True):
        torch.testing.assert_close(one, two, rtol=1e-6, atol=1e-6 * float(two.abs().max()))
