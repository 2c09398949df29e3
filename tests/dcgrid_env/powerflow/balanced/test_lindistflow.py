"""lindistflow: the linear formula from R and X, and how it compares with the exact power flow."""

import numpy as np
import pytest

from dcgrid_env import distflow, lindistflow, sensitivity


def test_is_the_formula_with_the_feeders_sensitivity(feeder, random_loads):
    p_kw, q_kvar, v0_pu = random_loads(feeder, 30, seed=20)
    r, x = sensitivity(feeder)
    v_sq = v0_pu[:, None] ** 2 - 2.0 * (p_kw @ r.T + q_kvar @ x.T) / 1000.0
    solution = lindistflow(feeder, p_kw, q_kvar, v0_pu)
    np.testing.assert_allclose(solution.v_pu, np.sqrt(v_sq), atol=1e-12, rtol=0.0)
    assert solution.converged.all()


def test_toy6_worked_by_hand(toy6, base):
    # 600 kW and 300 kvar in all; 500 kW and 250 kvar of it through the branch 0 - 1.
    solution = lindistflow(toy6, *base)
    np.testing.assert_allclose(solution.p_branch_kw, [500.0, 200.0, 300.0, 100.0, 100.0], rtol=1e-14)
    np.testing.assert_allclose(solution.q_branch_kvar, [250.0, 100.0, 150.0, 50.0, 50.0], rtol=1e-14)
    v_sq = [1.0, 0.98, 0.972, 0.968, 0.996, 0.992]  # a drop of 2 (0.01 P + 0.02 Q) a branch
    np.testing.assert_allclose(solution.v_pu, np.sqrt(v_sq), rtol=1e-14)


def test_has_no_currents_and_no_losses(feeder, random_loads):
    solution = lindistflow(feeder, *random_loads(feeder, 3, seed=21))
    assert not solution.current_sq_pu.any()
    assert not solution.loss_kw.any()
    assert not solution.residual_kva.any()
    assert (solution.iterations == 1).all()


def test_differs_from_distflow_by_the_square_of_the_load(feeder, random_loads):
    p_kw, q_kvar, _ = random_loads(feeder, 6, seed=22)
    errors = []
    for scale in (0.1, 0.05, 0.025):
        loads = scale * p_kw, scale * q_kvar
        exact = distflow(feeder, *loads, 1.0, tolerance_kva=1e-9)
        errors.append(np.abs(lindistflow(feeder, *loads, 1.0).v_pu - exact.v_pu).max(axis=-1))
    assert (errors[0] < 1e-3).all()
    np.testing.assert_allclose(errors[0] / errors[1], 4.0, rtol=0.1)
    np.testing.assert_allclose(errors[1] / errors[2], 4.0, rtol=0.05)


@pytest.mark.parametrize("n_row", [1, 20])
def test_a_load_that_drives_a_voltage_to_zero_is_not_converged(feeder, n_row):
    r, x = sensitivity(feeder)
    drop = 2.0 * (r @ feeder.p_load_kw + x @ feeder.q_load_kvar).max() / 1000.0  # of the squared voltage
    p_kw, q_kvar = (np.tile(load, (n_row, 1)) for load in (feeder.p_load_kw, feeder.q_load_kvar))
    p_kw[-1] *= 1.02 / drop
    q_kvar[-1] *= 1.02 / drop
    solution = lindistflow(feeder, p_kw, q_kvar, 1.0)
    assert solution.converged.tolist() == [True] * (n_row - 1) + [False]
    assert np.isfinite(solution.v_pu).all()
    within = lindistflow(feeder, p_kw * 0.95, q_kvar * 0.95, 1.0)
    assert within.converged.all()


@pytest.mark.parametrize("leading", [(), (3,), (2, 3), (0,)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_leading_dimensions_and_precision_are_those_of_the_loads(toy6, leading, dtype):
    load = np.full((*leading, 6), 10.0, dtype)
    solution = lindistflow(toy6, load, load)
    assert solution.v_pu.shape == (*leading, 6)
    assert solution.p_branch_kw.shape == (*leading, 5)
    assert solution.loss_kw.shape == solution.converged.shape == leading
    assert solution.v_pu.dtype == solution.loss_kw.dtype == dtype


def test_lists_and_read_only_arrays_are_taken_and_left_alone(toy6, base):
    p_kw, q_kvar = base
    p_kw.flags.writeable = False
    before = p_kw.tobytes(), q_kvar.tobytes()
    solution = lindistflow(toy6, p_kw, q_kvar)
    assert (p_kw.tobytes(), q_kvar.tobytes()) == before
    assert lindistflow(toy6, p_kw.tolist(), q_kvar.tolist()).v_pu.tobytes() == solution.v_pu.tobytes()
