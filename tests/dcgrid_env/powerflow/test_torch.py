"""Both forms for torch: the compiled kernels' answer, and derivatives that fit finite differences."""

import numpy as np
import pytest
import torch

from dcgrid_env import Feeder, PowerFlowError, Solution, distflow, lindistflow, load_feeder, sensitivity
from dcgrid_env.grid.network import RegulatorTable
from dcgrid_env.powerflow.unbalanced.array_form import sweep_arrays
from helpers.fast_paths import NAME, add_field, altered

DEVIATION = {"v_pu": 1e-7, "p_branch_kw": 1e-2, "q_branch_kvar": 1e-2, "current_sq_pu": 1e-4, "loss_kw": 1e-3}


@pytest.fixture(params=["compiled", "arrays"])
def form(request, by_arrays):
    """What solves tensors: the compiled kernels, or the array operations of other devices."""
    if request.param == "arrays":
        by_arrays()


both_forms = pytest.mark.usefixtures("form")


def double(values):
    return torch.tensor(np.asarray(values), dtype=torch.float64)


# --- the same answer as the compiled kernels ------------------------------------------------------------------------


@both_forms
@pytest.mark.parametrize("method", [distflow, lindistflow])
def test_agrees_with_the_compiled_kernel(feeder, random_loads, as_torch, as_numpy, method):
    loads = random_loads(feeder, 60, seed=30)
    compiled, arrays = method(feeder, *loads), as_numpy(method(feeder, *as_torch(*loads)))
    assert compiled.converged.all()
    np.testing.assert_array_equal(arrays.converged, compiled.converged)
    assert np.abs(arrays.iterations - compiled.iterations).max() <= 1
    for field, deviation in DEVIATION.items():
        found, expected = getattr(arrays, field), getattr(compiled, field)
        assert found.dtype == expected.dtype
        np.testing.assert_allclose(found, expected, atol=deviation, rtol=0.0, err_msg=field)


@both_forms
def test_the_residual_of_a_first_sweep_by_hand(two_bus, as_torch):
    # Squared current (1.2^2 + 0.5^2) / 1 where there was none, over the larger of 0.04 and 0.07: 118.3 kVA.
    loads = [0.0, 1200.0], [0.0, 500.0]
    for p_kw, q_kvar in (loads, as_torch(*loads)):
        solution = distflow(two_bus(0.04, 0.07), p_kw, q_kvar, 1.0, max_sweeps=1)
        assert not bool(solution.converged)
        assert float(solution.residual_kva) == pytest.approx(118.3, rel=1e-12)


@both_forms
def test_agrees_close_to_collapse_and_on_what_has_no_solution(feeder, as_torch, as_numpy):
    most = {"toy6": 14.0, "ieee33": 3.4, "das69": 3.1, "ieee123": 2.4, "khodr141": 4.1}[feeder.name]
    scale = most * np.array([[0.7], [0.9], [1.0], [1.2], [3.0]])
    loads = scale * feeder.p_load_kw, scale * feeder.q_load_kvar
    compiled, arrays = distflow(feeder, *loads), as_numpy(distflow(feeder, *as_torch(*loads)))
    assert compiled.converged.tolist() == arrays.converged.tolist() == [True, True, True, False, False]
    np.testing.assert_allclose(arrays.v_pu[:3], compiled.v_pu[:3], atol=1e-7, rtol=0.0)


@both_forms
@pytest.mark.parametrize("method", [distflow, lindistflow])
def test_float32_is_within_1e_5_of_float64(feeder, random_loads, method):
    loads = random_loads(feeder, 30, seed=31)
    single = method(feeder, *(torch.tensor(a, dtype=torch.float32) for a in loads))
    assert single.v_pu.dtype == single.loss_kw.dtype == torch.float32
    assert single.converged.all()
    np.testing.assert_allclose(single.v_pu.numpy(), method(feeder, *loads).v_pu, atol=1e-5, rtol=0.0)


@both_forms
@pytest.mark.parametrize("leading", [(), (1,), (3,), (2, 3), (0,)])
@pytest.mark.parametrize("method", [distflow, lindistflow])
def test_leading_dimensions_are_those_of_the_loads(toy6, method, leading):
    p_kw = double(toy6.p_load_kw).expand(*leading, 6)
    solution = method(toy6, p_kw, 0.5 * p_kw)
    assert solution.v_pu.shape == (*leading, 6)
    assert solution.p_branch_kw.shape == solution.current_sq_pu.shape == (*leading, 5)
    for field in ("loss_kw", "converged", "iterations", "residual_kva"):
        assert getattr(solution, field).shape == leading
    assert solution.converged.dtype == torch.bool
    assert not solution.iterations.is_floating_point()
    assert bool(solution.converged.all())


@both_forms
def test_substation_voltage_may_be_a_number_an_array_or_a_tensor(toy6):
    p_kw = double(toy6.p_load_kw).expand(3, 6)
    for v0_pu in (1.02, np.array([1.0, 1.01, 1.02]), double([1.0, 1.01, 1.02]), [1.0, 1.01, 1.02]):
        solution = distflow(toy6, p_kw, p_kw, v0_pu)
        np.testing.assert_allclose(solution.v_pu[:, 0].numpy(), np.broadcast_to(v0_pu, 3), rtol=1e-15)


@both_forms
def test_inputs_are_never_modified(toy6, random_loads, as_torch):
    given = [*as_torch(*random_loads(toy6, 20, seed=32)), torch.full((20, 5), 0.3, dtype=torch.float64)]
    before = [tensor.clone() for tensor in given]
    distflow(toy6, *given[:3], warm=given[3])
    lindistflow(toy6, *given[:3])
    assert all(torch.equal(a, b) for a, b in zip(given, before, strict=True))


@both_forms
def test_tensors_that_are_not_contiguous(toy6, random_loads, as_torch):
    p_kw, q_kvar, v0_pu = as_torch(*random_loads(toy6, 20, seed=33))
    turned = distflow(toy6, p_kw.T.contiguous().T, q_kvar.T.contiguous().T, v0_pu)
    np.testing.assert_allclose(turned.v_pu.numpy(), distflow(toy6, p_kw, q_kvar, v0_pu).v_pu.numpy(), atol=1e-12)


@both_forms
@pytest.mark.parametrize("dtype", [torch.int64, torch.int32, torch.float16, torch.bfloat16])
def test_other_precisions_are_solved_as_the_docstring_says(toy6, dtype):
    load = torch.full((6,), 64).to(dtype)
    solution = distflow(toy6, load, load, 1.04375)
    assert solution.v_pu.dtype == torch.float64
    assert solution.v_pu[0] == pytest.approx(1.04375, abs=1e-6)
    np.testing.assert_allclose(solution.v_pu, distflow(toy6, [64.0] * 6, [64.0] * 6, 1.04375).v_pu, atol=1e-5)


@both_forms
def test_a_parameter_is_a_tensor(toy6):
    q_kvar = torch.nn.Parameter(torch.zeros(6, dtype=torch.float64))
    distflow(toy6, double(toy6.p_load_kw), q_kvar).loss_kw.backward()
    assert q_kvar.grad is not None


# --- warm starts and loads without a solution -----------------------------------------------------------------------


@both_forms
def test_a_warm_start_gives_the_same_answer_in_fewer_sweeps(feeder, random_loads, as_torch):
    p_kw, q_kvar, v0_pu = as_torch(*random_loads(feeder, 40, seed=34))
    before = distflow(feeder, 0.999 * p_kw, 0.999 * q_kvar, v0_pu)
    cold = distflow(feeder, p_kw, q_kvar, v0_pu)
    for start in (before, before.restart):
        warm = distflow(feeder, p_kw, q_kvar, v0_pu, warm=start)
        assert bool(warm.converged.all())
        assert bool((warm.iterations < cold.iterations).all())
        np.testing.assert_allclose(warm.v_pu.numpy(), cold.v_pu.numpy(), atol=1e-7, rtol=0.0)


@both_forms
def test_a_warm_start_from_a_very_different_load_still_converges(feeder):
    p_kw, q_kvar = double(feeder.p_load_kw).expand(3, -1), double(feeder.q_load_kvar).expand(3, -1)
    start = torch.zeros((3, feeder.n_bus - 1), dtype=torch.float64)
    start[1], start[2] = 1e6, float("nan")
    cold, warm = distflow(feeder, p_kw, q_kvar), distflow(feeder, p_kw, q_kvar, warm=start)
    assert bool(warm.converged.all())
    np.testing.assert_allclose(warm.v_pu.numpy(), cold.v_pu.numpy(), atol=1e-7, rtol=0.0)


@both_forms
@pytest.mark.parametrize("n_row", [5, 33])
@pytest.mark.parametrize("warm", [False, True])
def test_a_row_without_a_solution_leaves_its_neighbours_their_bits(feeder, random_loads, as_torch, n_row, warm):
    p_kw, q_kvar, v0_pu = as_torch(*random_loads(feeder, n_row, seed=35))
    start = distflow(feeder, 0.9 * p_kw, q_kvar, v0_pu) if warm else None
    good = distflow(feeder, p_kw, q_kvar, v0_pu, warm=start)
    for bad in (0, 3, n_row - 1):
        worse = p_kw.clone()
        worse[bad] = (40.0 if feeder.name == "toy6" else 6.0) * double(feeder.p_load_kw)
        solution = distflow(feeder, worse, q_kvar, v0_pu, warm=start)
        assert not solution.converged[bad]
        others = torch.arange(n_row) != bad
        for field in Solution._fields:
            assert torch.equal(getattr(solution, field)[others], getattr(good, field)[others]), field


@both_forms
@pytest.mark.parametrize("scale", [1.0, 5.0, 1e3, 1e9, -1e3, -1e9])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_figures_without_a_solution_are_finite(feeder, scale, dtype):
    scale *= 40.0 if feeder.name == "toy6" else 6.0
    solution = distflow(feeder, *(torch.tensor(scale * a, dtype=dtype) for a in (feeder.p_load_kw, feeder.q_load_kvar)))
    assert not solution.converged
    for field in ("v_pu", "p_branch_kw", "q_branch_kvar", "current_sq_pu", "loss_kw"):
        assert bool(torch.isfinite(getattr(solution, field)).all()), field


# --- derivatives ----------------------------------------------------------------------------------------------------


def in_megawatts(feeder, method=distflow, **options):
    """Voltages and loss (MW) as a function of load in MW and Mvar and v0, all of order one for finite differences."""

    def function(p_mw, q_mvar, v0_pu):
        solution = method(feeder, 1000.0 * p_mw, 1000.0 * q_mvar, v0_pu, **options)
        assert bool(solution.converged.all())
        return solution.v_pu, solution.loss_kw / 1000.0

    return function


def recorded(*arrays):
    return tuple(double(a).requires_grad_() for a in arrays)


def gradcheck(function, inputs):
    # Derivatives of voltage are some 1e-2 p.u. a MW, so the absolute tolerance must be far below that.
    assert torch.autograd.gradcheck(function, inputs, eps=1e-5, atol=1e-8, rtol=1e-5)


@both_forms
@pytest.mark.parametrize("scale", [1.0, 8.0, 12.0, -5.0])
@pytest.mark.slow
def test_derivatives_of_distflow(toy6, scale):
    load = scale * toy6.p_load_kw / 1000.0, scale * toy6.q_load_kvar / 1000.0
    v_pu, _ = in_megawatts(toy6)(*recorded(*load, 1.02))
    assert float(v_pu.detach().min()) < {1.0: 1.1, 8.0: 0.9, 12.0: 0.8, -5.0: 1.1}[scale]
    gradcheck(in_megawatts(toy6, tolerance_kva=1e-9), recorded(*load, 1.02))


@both_forms
@pytest.mark.slow
def test_derivatives_of_a_batch(toy6):
    rng = np.random.default_rng(36)
    load = rng.uniform(-1.0, 2.0, (2, 3, 6)), rng.uniform(-1.0, 1.0, (2, 3, 6)), rng.uniform(0.95, 1.05, (2, 3))
    gradcheck(in_megawatts(toy6, tolerance_kva=1e-9), recorded(*load))


@both_forms
@pytest.mark.parametrize("scale", [1.0, 12.0])
@pytest.mark.slow
def test_derivatives_with_a_warm_start(toy6, scale):
    # A start at the answer must not stop the sweeps before the derivative has converged.
    load = scale * toy6.p_load_kw / 1000.0, scale * toy6.q_load_kvar / 1000.0
    start = distflow(toy6, double(1000.0 * load[0]), double(1000.0 * load[1]), 1.02)
    gradcheck(in_megawatts(toy6, tolerance_kva=1e-9, warm=start), recorded(*load, 1.02))


def test_derivatives_of_lindistflow(toy6):
    rng = np.random.default_rng(37)
    inputs = recorded(rng.uniform(-1.0, 2.0, (3, 6)), rng.uniform(-1.0, 1.0, (3, 6)), [0.98, 1.0, 1.05])
    gradcheck(lambda p, q, v0: lindistflow(toy6, 1000.0 * p, 1000.0 * q, v0).v_pu, inputs)


@both_forms
def test_derivatives_at_the_default_tolerance(feeder):
    # The derivative lags the voltage by some sweeps; at base load it must be right to a part in a thousand.
    def slope(tolerance_kva):
        p_kw, q_kvar = recorded(feeder.p_load_kw, feeder.q_load_kvar)
        distflow(feeder, p_kw, q_kvar, tolerance_kva=tolerance_kva).v_pu.sum().backward()
        assert p_kw.grad is not None
        assert q_kvar.grad is not None
        return p_kw.grad, q_kvar.grad

    for usual, fine in zip(slope(None), slope(1e-9), strict=True):
        assert float(fine[1:].abs().max()) > 1e-6
        np.testing.assert_allclose(usual, fine, rtol=1e-3, atol=1e-9)


@both_forms
def test_derivative_at_little_load_is_the_sensitivity(feeder):
    r, x = sensitivity(feeder)
    p_kw, q_kvar = recorded(np.full(feeder.n_bus, 1e-3), np.full(feeder.n_bus, 1e-3))
    v_pu = distflow(feeder, p_kw, q_kvar, 1.0).v_pu
    i = int(v_pu.argmin())
    by_p, by_q = torch.autograd.grad(v_pu[i], (p_kw, q_kvar))
    np.testing.assert_allclose(1000.0 * by_p, -r[i], atol=1e-4 * r.max())
    np.testing.assert_allclose(1000.0 * by_q, -x[i], atol=1e-4 * x.max())


@both_forms
@pytest.mark.parametrize("scale", [1.0, 5.0, 1e3])
@pytest.mark.parametrize("warm", [False, True])
def test_gradients_stay_finite_beside_a_row_without_a_solution(feeder, scale, warm):
    p_kw, q_kvar = (np.tile(load, (4, 1)) for load in (feeder.p_load_kw, feeder.q_load_kvar))
    good = recorded(p_kw, q_kvar, np.full(4, 1.02))
    start = torch.zeros((4, feeder.n_bus - 1), dtype=torch.float64) if warm else None
    solution = distflow(feeder, *good, warm=start)
    (solution.v_pu.sum() + solution.loss_kw.sum()).backward()
    p_kw[2] *= scale * (40.0 if feeder.name == "toy6" else 6.0)
    inputs = recorded(p_kw, q_kvar, np.full(4, 1.02))
    solution = distflow(feeder, *inputs, warm=start)
    assert solution.converged.tolist() == [True, True, False, True]
    (solution.v_pu.sum() + solution.loss_kw.sum()).backward()
    for one, other in zip(inputs, good, strict=True):
        assert one.grad is not None
        assert other.grad is not None
        assert bool(torch.isfinite(one.grad).all())
        np.testing.assert_allclose(one.grad[[0, 1, 3]], other.grad[[0, 1, 3]], rtol=1e-12)


@pytest.mark.slow
def test_torch_is_not_imported_for_numpy_arrays():
    import subprocess
    import sys

    program = (
        "import sys, numpy, dcgrid_env as d; f = d.load_feeder('toy6');"
        "d.distflow(f, f.p_load_kw, f.q_load_kvar); assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)


@both_forms
def test_gradient_steps_through_distflow_lower_the_loss():
    # What the derivative is for: reactive power at three buses, chosen by plain descent.
    feeder = load_feeder("ieee33")
    p_kw, q_kvar = double(feeder.p_load_kw), double(feeder.q_load_kvar)
    at = [feeder.index(bus) for bus in (14, 30, 25)]
    injected = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    losses = []
    for _ in range(30):
        loss_kw = distflow(feeder, p_kw, q_kvar.index_add(0, torch.tensor(at), -injected)).loss_kw
        losses.append(float(loss_kw.detach()))
        (slope,) = torch.autograd.grad(loss_kw, injected)
        injected = (injected - 1500.0 * slope).detach().requires_grad_()
    assert np.diff(losses).max() < 0.0
    assert losses[-1] < 0.72 * losses[0]


@pytest.mark.parametrize("name", ["toy6", "ieee13-3ph"])
def test_array_operations_refuse_a_feeder_with_a_field_that_they_do_not_cover(name, monkeypatch):
    feeder = load_feeder(name)
    kind, path = (Feeder, NAME) if name == "toy6" else (RegulatorTable, f"network.regulator.{NAME}")
    add_field(monkeypatch, kind)
    solve(altered(feeder))
    with pytest.raises(PowerFlowError, match=f"feeder '{name}'.*{kind.__name__}.{NAME}.*give NumPy arrays"):
        solve(altered(feeder, path, 1.0))


def solve(feeder):
    """Solve without load in array operations."""
    if isinstance(feeder, Feeder):
        load = torch.zeros(2, feeder.n_bus)
        return lindistflow(feeder, load, load)
    load, one = torch.zeros(2, feeder.n_leg), torch.ones(2)
    of_equipment = torch.ones(2, feeder.n_regulator), torch.ones(2, feeder.n_capacitor)
    return sweep_arrays(feeder, (load, load, one, *of_equipment), None, 1e-6, 100)
