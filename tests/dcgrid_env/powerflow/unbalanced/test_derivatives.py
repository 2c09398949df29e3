"""Derivatives of the sweep: compiled against finite differences and the recorded sweeps, and the sensitivity."""

from typing import Any

import numpy as np
import pytest
import torch

from dcgrid_env import load_feeder, own_sensitivity, sensitivity
from dcgrid_env.powerflow import PowerFlowError, linearise, solve_unbalanced
from dcgrid_env.powerflow.unbalanced.array_form import sweep_arrays

FIGURES = ("v_pu", "v_re_pu", "v_im_pu", "i_re_a", "i_im_a", "loss_kw", "source_p_kw", "source_q_kvar")
EXACT = {"tolerance_pu": 1e-13}
CLOSE = 1e-6


def tensors(inputs):
    return type(inputs)(*(torch.tensor(a, requires_grad=True) for a in inputs))


def weighted(solution, weights) -> Any:
    return sum((getattr(solution, name) * weight).sum() for name, weight in weights.items())


@pytest.fixture
def weights(feeder):
    rng = np.random.default_rng(5)
    sizes = {name: (feeder.n_node,) if name[0] in "vi" else () for name in FIGURES}
    return {name: torch.tensor(rng.normal(size=(9, *size))) for name, size in sizes.items()}


@pytest.mark.parametrize("chosen", [FIGURES[:1], FIGURES[3:5], FIGURES[5:6], FIGURES])
@pytest.mark.parametrize("by", range(5))
def test_against_finite_differences(feeder, random_inputs, solved, weights, chosen, by):
    rng, inputs = np.random.default_rng(6), random_inputs(feeder, 9, 7)
    inputs = inputs._replace(state=np.full_like(inputs.state, 0.5))
    direction = rng.normal(size=inputs[by].shape) * (5.0 if by < 2 else 0.01)
    weights = {name: weights[name] for name in chosen}
    given = tensors(inputs)
    (gradient,) = torch.autograd.grad(weighted(solved(feeder, given, **EXACT), weights), given[by])

    def value(step):
        moved = inputs._replace(**{inputs._fields[by]: inputs[by] + step * direction})
        return float(weighted(solved(feeder, moved, **EXACT), {k: w.numpy() for k, w in weights.items()}))

    h = 1e-4
    slope = (8.0 * (value(h) - value(-h)) - (value(2 * h) - value(-2 * h))) / (12.0 * h)
    scale = float((gradient.abs() * torch.tensor(direction).abs()).max())
    assert float((gradient * torch.tensor(direction)).sum()) == pytest.approx(slope, rel=CLOSE, abs=CLOSE * scale)


def test_against_the_recorded_sweeps(feeder, random_inputs, solved, weights):
    inputs = random_inputs(feeder, 9, 8)
    given, recorded = tensors(inputs), tensors(inputs)
    one = torch.autograd.grad(weighted(solved(feeder, given, **EXACT), weights), given)
    solution = sweep_arrays(feeder, recorded, None, 1e-13, 1000)
    two = torch.autograd.grad(weighted(solution, weights), recorded)
    for a, b in zip(one, two, strict=True):
        torch.testing.assert_close(a, b, rtol=CLOSE, atol=CLOSE * float(b.abs().max()))


def test_the_array_form_solves_what_the_kernels_solve(feeder, random_inputs, solved):
    inputs = random_inputs(feeder, 5, 9)
    one = solved(feeder, inputs, **EXACT)
    for given in (tensors(inputs), inputs):
        two = sweep_arrays(feeder, tuple(given), None, 1e-13, 1000)
        for name in (*FIGURES, "restart"):
            b = getattr(two, name)
            b = b.detach().numpy() if isinstance(b, torch.Tensor) else b
            np.testing.assert_allclose(b, getattr(one, name), rtol=1e-9, atol=1e-9)
    again = sweep_arrays(feeder, tuple(inputs), one.restart, 5e-9, 1000)
    assert (again.iterations <= 2).all()
    start = np.concatenate((np.full_like(one.restart[:2], np.nan), 0.0 * one.restart[2:]))
    again = sweep_arrays(feeder, tuple(inputs), start, 5e-9, 1000)
    np.testing.assert_allclose(again.v_pu, one.v_pu, rtol=0.0, atol=1e-8)


def test_tensors_in_single_precision(feeder, random_inputs, solved):
    inputs = random_inputs(feeder, 4, 10)
    single = type(inputs)(*(torch.tensor(a, dtype=torch.float32, requires_grad=True) for a in inputs))
    exact = solved(feeder, inputs)
    for solution in (solved(feeder, single), sweep_arrays(feeder, single, None, 5e-9, 1000)):
        assert solution.v_pu.dtype == torch.float32
        assert bool(solution.converged.all())
        np.testing.assert_allclose(solution.v_pu.detach().numpy(), exact.v_pu, rtol=0.0, atol=5e-5)
        (gradient,) = torch.autograd.grad(solution.v_pu.sum(), single.p_kw)
        assert gradient.dtype == torch.float32
        assert bool(torch.isfinite(gradient).all())


def test_a_row_without_a_solution_has_no_derivative(random_inputs, solved):
    feeder = load_feeder("ieee13-3ph")
    inputs = random_inputs(feeder, 9, 11)
    inputs.p_kw[4, feeder.first_device_leg + 20] = 1e5
    given = tensors(inputs)
    solution = solved(feeder, given)
    assert solution.converged.tolist() == [row != 4 for row in range(9)]
    gradients = torch.autograd.grad(solution.v_pu.sum() + solution.loss_kw.sum(), given)
    for gradient in gradients:
        assert bool(torch.isfinite(gradient).all())
        assert not bool(gradient[4].any())
        assert bool(gradient[5].any())
    recorded = sweep_arrays(feeder, given, None, 5e-9, 200)
    assert recorded.converged.tolist() == solution.converged.tolist()
    (gradient,) = torch.autograd.grad(recorded.v_pu[recorded.converged].sum(), given.p_kw)
    assert bool(torch.isfinite(gradient).all())


def test_the_derivative_has_none_of_its_own(random_inputs, solved):
    feeder = load_feeder("ieee13-3ph")
    given = tensors(random_inputs(feeder, 2, 12))
    with pytest.raises(RuntimeError, match="leave out create_graph=True"):
        torch.autograd.grad(solved(feeder, given).v_pu.sum(), given.p_kw, create_graph=True)


def test_sensitivity_is_the_slope_of_the_base_case(feeder):
    slopes, n_load = sensitivity(feeder), feeder.first_device_leg
    assert slopes is sensitivity(feeder)
    for node in (0, feeder.n_node // 2, feeder.n_node - 1):
        for slope, of_q in zip(slopes, (False, True), strict=True):
            moved = np.tile(feeder.q_load_kvar if of_q else feeder.p_load_kw, (2, 1))
            moved[:, n_load + node] += (-0.1, 0.1)
            loads = (np.tile(feeder.p_load_kw, (2, 1)), moved) if of_q else (moved, np.tile(feeder.q_load_kvar, (2, 1)))
            v_pu = solve_unbalanced(feeder, *loads, tolerance_pu=1e-13).v_pu
            np.testing.assert_allclose(slope[:, node], (v_pu[0] - v_pu[1]) / 2e-4, rtol=1e-5, atol=1e-8)
    for own, slope in zip(own_sensitivity(feeder), slopes, strict=True):
        np.testing.assert_array_equal(own, np.diagonal(slope))
        assert not own.flags.writeable


def test_sensitivity_is_signed_and_goes_across_phases():
    feeder = load_feeder("ieee123-3ph")
    a, b, _ = feeder.nodes_of("450")
    slopes = sensitivity(feeder)
    assert 0.1 * slopes.by_q_pu_per_mvar[a, a] == pytest.approx(0.020, abs=1e-3)
    assert 0.1 * slopes.by_q_pu_per_mvar[a, b] == pytest.approx(-0.007, abs=1e-3)
    assert -0.1 * slopes.by_p_pu_per_mw[b, a] == pytest.approx(0.009, abs=1e-3)


def test_a_power_flow_without_a_solution_is_not_linearised():
    feeder = load_feeder("ieee13-3ph")
    heavy = feeder.p_load_kw + 1e5 * (np.arange(feeder.n_leg) == feeder.n_leg - 1)
    with pytest.raises(PowerFlowError, match="converged is False; give one power flow that has a solution"):
        linearise(feeder, heavy, feeder.q_load_kvar)
