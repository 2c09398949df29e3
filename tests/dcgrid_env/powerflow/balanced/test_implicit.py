"""The compiled derivative: that of the recorded sweeps, of finite differences, and of two buses worked by hand."""

import numpy as np
import pytest
import torch

from dcgrid_env import Solution, distflow
from dcgrid_env.powerflow.balanced.implicit import distflow_tensors
from dcgrid_env.powerflow.balanced.prefix import distflow_arrays
from dcgrid_env.powerflow.solution import V_SQ_FLOOR

FIGURES = ("v_pu", "p_branch_kw", "q_branch_kvar", "current_sq_pu", "loss_kw")
EXACT = 1e-13  # per unit, far below what a derivative is compared to


def recorded(*arrays, dtype=torch.float64):
    return tuple(torch.tensor(np.asarray(a), dtype=dtype, requires_grad=True) for a in arrays)


def weighted(solution, seed):
    """The five figures under random weights, each figure counting about as much as any other."""
    rng, total = np.random.default_rng(seed), torch.zeros(())
    for name in FIGURES:
        values = getattr(solution, name)
        weight = torch.tensor(rng.normal(size=tuple(values.shape)), dtype=values.dtype)
        total = total + (weight * values).sum() / (values.detach().abs().max() + 1e-9)
    return total


def slopes(solve, feeder, loads, seed=0, **options):
    inputs = recorded(*loads, **options)
    weighted(solve(feeder, *inputs, None, EXACT, 2000), seed).backward()
    return [one.grad for one in inputs]


def assert_close(found, expected, share):
    """Equal to within a share of the largest."""
    for one, other in zip(found, expected, strict=True):
        scale = float(other.abs().max())
        assert scale > 0.0
        np.testing.assert_allclose(one / scale, other / scale, atol=share, rtol=0.0)


@pytest.mark.parametrize("seed", [0, 1])
def test_it_is_the_derivative_of_the_recorded_sweeps(feeder, random_loads, seed):
    loads = random_loads(feeder, 21, seed=50 + seed)
    found, expected = (slopes(solve, feeder, loads, seed) for solve in (distflow_tensors, distflow_arrays))
    assert_close(found, expected, 1e-8)


@pytest.mark.parametrize("share", [0.5, 0.9, 0.99, 0.999])
def test_it_is_the_derivative_of_the_recorded_sweeps_close_to_collapse(feeder, share):
    most = share * {"toy6": 14.44, "ieee33": 3.618, "das69": 3.208, "ieee123": 2.523, "khodr141": 4.21}[feeder.name]
    loads = most * feeder.p_load_kw[None], most * feeder.q_load_kvar[None], np.full(1, feeder.v0_pu)
    found, expected = (slopes(solve, feeder, loads) for solve in (distflow_tensors, distflow_arrays))
    assert_close(found, expected, 1e-7)


@pytest.mark.parametrize("figure", FIGURES)
@pytest.mark.parametrize("scale", [1.0, 12.0, -5.0])
def test_each_figure_fits_finite_differences(toy6, figure, scale):
    def function(p_mw, q_mvar, v0_pu):
        solution = distflow_tensors(toy6, 1000.0 * p_mw, 1000.0 * q_mvar, v0_pu, None, EXACT, 2000)
        assert bool(solution.converged)
        return getattr(solution, figure) * (1e-3 if "kw" in figure or "kvar" in figure else 1.0)

    load = recorded(scale * toy6.p_load_kw / 1000.0, scale * toy6.q_load_kvar / 1000.0, 1.02)
    assert torch.autograd.gradcheck(function, load, eps=1e-5, atol=1e-7, rtol=1e-5)


def test_two_buses_by_hand(two_bus):
    # w^2 + w (2 (r p + x q) - w0) + (r^2 + x^2) (p^2 + q^2) = 0, w = v^2, differentiated by v0, p and q.
    r, x, p, q, v0 = 0.04, 0.07, 1.2, 0.5, 1.03
    feeder, z_sq, w0 = two_bus(r, x), r * r + x * x, v0 * v0
    half = (w0 - 2.0 * (r * p + x * q)) / 2.0
    w = half + np.sqrt(half * half - z_sq * (p * p + q * q))
    steep = 2.0 * w + 2.0 * (r * p + x * q) - w0
    expected = {
        "v0": w / steep * v0 / np.sqrt(w),
        "p": -(2.0 * r * w + 2.0 * z_sq * p) / steep / (2.0 * np.sqrt(w)) / 1000.0,
        "q": -(2.0 * x * w + 2.0 * z_sq * q) / steep / (2.0 * np.sqrt(w)) / 1000.0,
    }
    inputs = recorded([0.0, 1000.0 * p], [0.0, 1000.0 * q], v0)
    v_pu = distflow(feeder, *inputs, tolerance_kva=1e-9).v_pu
    assert float(v_pu[1].detach()) == pytest.approx(np.sqrt(w), rel=1e-10)
    by_p, by_q, by_v0 = torch.autograd.grad(v_pu[1], inputs)
    assert float(by_v0) == pytest.approx(expected["v0"], rel=1e-8)
    assert by_p.tolist() == pytest.approx([0.0, expected["p"]], rel=1e-8)  # load at the substation moves nothing
    assert by_q.tolist() == pytest.approx([0.0, expected["q"]], rel=1e-8)


def test_the_substation_voltage_of_all_rows_or_of_each(toy6, random_loads):
    p_kw, q_kvar, _ = random_loads(toy6, 4, seed=51)
    (one,), (each,) = recorded(1.02), recorded(np.full(4, 1.02))
    for v0 in (one, each):
        distflow(toy6, torch.tensor(p_kw), torch.tensor(q_kvar), v0).v_pu.sum().backward()
    assert one.grad is not None
    assert each.grad is not None
    assert float(one.grad) == pytest.approx(float(each.grad.sum()), rel=1e-12)
    assert float(each.grad.min()) > 6.0  # six buses, each of which rises by more than the substation does


def test_the_figures_are_those_of_numpy_to_the_bit(feeder, random_loads):
    for dtype in (np.float32, np.float64):
        loads = [a.astype(dtype) for a in random_loads(feeder, 20, seed=52)]
        expected, found = distflow(feeder, *loads), distflow(feeder, *map(torch.tensor, loads))
        for name in Solution._fields:
            np.testing.assert_array_equal(getattr(found, name).numpy(), getattr(expected, name), err_msg=name)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("scale", [1.0, 1e3, 1e9, -1e3, -1e9])
def test_a_row_without_a_solution_has_derivative_0(feeder, scale, dtype):
    worse = scale * (40.0 if feeder.name == "toy6" else 6.0)
    factors = np.array([[1.0], [worse], [1.0]])
    inputs = recorded(factors * feeder.p_load_kw, factors * feeder.q_load_kvar, np.full(3, 1.02), dtype=dtype)
    solution = distflow(feeder, *inputs)
    assert solution.converged.tolist() == [True, False, True]
    assert float(solution.v_pu.detach().min()) >= np.float32(np.sqrt(V_SQ_FLOOR)) * 0.999
    torch.stack([getattr(solution, name).sum() for name in FIGURES]).sum().backward()
    for one in inputs:
        assert one.grad is not None
        assert bool(torch.isfinite(one.grad).all())
        assert not one.grad[1].any()
        assert one.grad[0].any()
        assert torch.equal(one.grad[0], one.grad[2])


@pytest.mark.parametrize("leading", [(), (1,), (2, 3), (0,)])
def test_derivatives_have_the_shape_of_the_loads(toy6, random_loads, leading):
    n_row = int(np.prod(leading))
    flat = recorded(*random_loads(toy6, max(n_row, 1), seed=53))
    shaped = [one.detach()[:n_row].reshape(leading + one.shape[1:]).requires_grad_() for one in flat]
    for inputs in (flat, shaped):
        solution = distflow(toy6, *inputs)
        (solution.v_pu.sum() + solution.loss_kw.sum()).backward()
    for one, other in zip(shaped, flat, strict=True):
        assert one.grad is not None
        assert other.grad is not None
        assert one.grad.shape == one.shape
        assert torch.equal(one.grad.reshape(other.grad[:n_row].shape), other.grad[:n_row])


def test_float32_is_close_to_float64(feeder, random_loads):
    loads = random_loads(feeder, 12, seed=54)
    single, double = recorded(*loads, dtype=torch.float32), recorded(*loads)
    for inputs in (single, double):
        weighted(distflow(feeder, *inputs), 3).backward()
    assert all(one.grad is not None and one.grad.dtype == torch.float32 for one in single)
    assert_close([one.grad for one in single], [one.grad for one in double], 1e-3)


def test_a_warm_start_leaves_the_derivative(feeder, random_loads):
    loads = random_loads(feeder, 12, seed=55)
    start = distflow(feeder, 0.99 * loads[0], loads[1], loads[2]).restart
    cold, warm = recorded(*loads), recorded(*loads)
    weighted(distflow(feeder, *cold, tolerance_kva=1e-9), 4).backward()
    weighted(distflow(feeder, *warm, warm=torch.tensor(start), tolerance_kva=1e-9), 4).backward()
    assert_close([one.grad for one in warm], [one.grad for one in cold], 1e-9)


@pytest.mark.parametrize("threads", ["1", "3"])
def test_rows_do_not_depend_on_their_neighbours_nor_on_threads(toy6, random_loads, monkeypatch, threads):
    monkeypatch.setenv("DCGRID_NUM_THREADS", threads)
    inputs = recorded(*random_loads(toy6, 203, seed=56))
    distflow(toy6, *inputs).v_pu.pow(2).sum().backward()
    for row in (0, 31, 32, 100, 202):
        own = recorded(*(one.detach()[row].numpy() for one in inputs))
        distflow(toy6, *own).v_pu.pow(2).sum().backward()
        for one, alone in zip(inputs, own, strict=True):
            assert one.grad is not None
            assert alone.grad is not None
            # A block of rows sweeps until its last one has settled.
            np.testing.assert_allclose(one.grad[row], alone.grad, rtol=1e-7, atol=1e-12)


def test_only_what_is_asked_for_is_recorded(toy6, base):
    plain = distflow(toy6, *map(torch.tensor, base))
    assert not any(a.requires_grad for a in plain)
    (q_kvar,) = recorded(base[1])
    solution = distflow(toy6, torch.tensor(base[0]), q_kvar)
    assert [a.requires_grad for a in solution] == [True] * 5 + [False] * 4
    (by_q,) = torch.autograd.grad(solution.loss_kw, q_kvar)
    assert float(by_q[1:].min()) > 0.0  # more reactive load, more loss


def test_weights_that_are_not_contiguous(toy6, random_loads):
    loads = random_loads(toy6, 6, seed=57)
    one, other = recorded(*loads), recorded(*loads)
    weight = torch.arange(36, dtype=torch.float64).reshape(6, 6)
    distflow(toy6, *one).v_pu.backward(weight.T)
    distflow(toy6, *other).v_pu.backward(weight.T.contiguous())
    assert all(torch.equal(a.grad, b.grad) for a, b in zip(one, other, strict=True))  # pyright: ignore


def test_a_second_derivative_is_refused(toy6, base):
    p_kw, q_kvar = recorded(*base)
    loss_kw = distflow(toy6, p_kw, q_kvar).loss_kw
    for weighed in (loss_kw, loss_kw * loss_kw):
        with pytest.raises(RuntimeError, match="no derivative of its own; leave out create_graph=True"):
            torch.autograd.grad(weighed, p_kw, create_graph=True)
