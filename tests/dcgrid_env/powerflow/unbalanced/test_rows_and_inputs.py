"""The same bits in any row and on any number of threads, starts, and what is refused by name."""

import re

import numpy as np
import pytest

from dcgrid_env import load_feeder
from dcgrid_env.core import threads
from dcgrid_env.powerflow import Control, PowerFlowError, solve_unbalanced, solver_for

N_ROW = 140


def bits(solution, row):
    return [np.asarray(figures[row]).tobytes() for figures in solution]


def test_same_bits_alone_and_in_any_row(feeder, random_inputs, solved):
    inputs = random_inputs(feeder, N_ROW, 30)
    whole = solved(feeder, inputs)
    assert whole.converged.all()
    for row in (0, 31, 32, N_ROW - 1):
        alone = solved(feeder, type(inputs)(*(a[row] for a in inputs)))
        assert bits(whole, row) == [np.asarray(figures).tobytes() for figures in alone]
    shifted = solved(feeder, type(inputs)(*(a[5:77] for a in inputs)))
    assert bits(shifted, 3) == bits(whole, 8)
    deep = type(inputs)(*(a.reshape(10, 14, *a.shape[1:]) for a in inputs))
    assert bits(solved(feeder, deep), (2, 3)) == bits(whole, 31)


@pytest.mark.parametrize("number", ["1", "2", "3"])
def test_same_bits_on_any_number_of_threads(random_inputs, solved, monkeypatch, number):
    feeder = load_feeder("ieee123-3ph")
    inputs = random_inputs(feeder, 400, 31)
    before = solved(feeder, inputs)
    monkeypatch.setenv("DCGRID_NUM_THREADS", number)
    monkeypatch.setattr(threads, "_pool", None)
    for one, two in zip(solved(feeder, inputs), before, strict=True):
        assert one.tobytes() == two.tobytes()


def test_a_start_saves_sweeps_and_changes_nothing_else(feeder, random_inputs, solved):
    inputs = random_inputs(feeder, 40, 32)
    cold = solved(feeder, inputs)
    near = inputs._replace(p_kw=inputs.p_kw * 1.001)
    warm = solved(feeder, near, start=cold)
    assert warm.iterations.mean() < 0.85 * cold.iterations.mean()
    np.testing.assert_allclose(warm.v_pu, solved(feeder, near).v_pu, rtol=0.0, atol=2e-8)
    for start in (np.nan, 0.0, 1e9):
        again = solved(feeder, inputs, start=np.full_like(cold.restart, start))
        np.testing.assert_allclose(again.v_pu, cold.v_pu, rtol=0.0, atol=2e-8)
    alone = solved(feeder, type(inputs)(*(a[3] for a in near)), start=cold.restart[3])
    assert alone.v_pu.tobytes() == warm.v_pu[3].tobytes()


def test_found_behind_the_protocol_of_all_solvers(feeder):
    solve = solver_for(feeder, "sweep")
    solution = solve(feeder, feeder.p_load_kw, feeder.q_load_kvar, feeder.v0_pu)
    assert solution.v_pu.tobytes() == solve_unbalanced(feeder, feeder.p_load_kw, feeder.q_load_kvar).v_pu.tobytes()
    with pytest.raises(PowerFlowError, match=r"no power flow 'distflow'; choose one of sweep"):
        solver_for(feeder, "distflow")


def test_controls_move_what_they_should():
    feeder = load_feeder("ieee13-3ph")
    base = feeder.p_load_kw, feeder.q_load_kvar
    plain = solve_unbalanced(feeder, *base)
    same = Control(tap_ratio=feeder.tap_ratio(feeder.base_tap), capacitor_on=feeder.base_capacitor_on)
    assert solve_unbalanced(feeder, *base, control=same).v_pu.tobytes() == plain.v_pu.tobytes()
    up = solve_unbalanced(feeder, *base, control=Control(tap_ratio=feeder.tap_ratio(feeder.base_tap + 1.0)))
    assert (up.v_pu[6:] > plain.v_pu[6:]).all()
    shunt = np.zeros(feeder.n_node)
    shunt[list(feeder.nodes_of("680"))] = 50.0
    q_kvar = base[1].copy()
    q_kvar[feeder.first_device_leg + np.array(feeder.nodes_of("680"))] = -50.0
    switched = solve_unbalanced(feeder, *base, control=Control(shunt_kvar=shunt))
    assert switched.v_pu.tobytes() == solve_unbalanced(feeder, base[0], q_kvar).v_pu.tobytes()


@pytest.mark.parametrize(("change", "message"), [
    ({"p_kw": np.zeros(41)}, r"p_kw has shape \(41,\) and q_kvar \(58,\); both must be \(..., 58\): 17 legs of loads"),
    ({"source_voltage_pu": -1.0}, "v0_pu is -1.0; give a positive"),
    ({"control": Control(tap_ratio=np.array([1.0, 1.2, 1.0]))},
     r"regulator reg2: tap_ratio is 1\.2 in scenario \(\) of the batch; tap 32 is not from -16 to 16"),
    ({"control": Control(tap_ratio=np.array([1.0, np.nan, 1.0]))}, r"regulator reg2: tap_ratio is nan"),
    ({"control": Control(tap_ratio=np.ones(2))}, r"tap_ratio has shape \(2,\); give \(3,\)"),
    ({"control": Control(capacitor_on=np.array([0.0, 1.5]))}, r"capacitor cap2: capacitor_on is 1\.5 .* from 0 to 1"),
    ({"control": Control(shunt_kvar=np.zeros(3))}, r"shunt_kvar has shape \(3,\); give \(41,\)"),
    ({"start": np.zeros(41)}, r"start has shape \(41,\); for these loads it must be \(82,\)"),
    ({"tolerance_pu": 0.0}, r"tolerance_pu is 0\.0; give a positive number"),
    ({"max_sweeps": 0}, r"max_sweeps is 0; give a whole number from 1"),
])  # fmt: skip
def test_what_is_refused_by_name(change, message):
    feeder = load_feeder("ieee13-3ph")
    given = {"p_kw": feeder.p_load_kw, "q_kvar": feeder.q_load_kvar} | change
    with pytest.raises(PowerFlowError, match=message):
        solve_unbalanced(feeder, **given)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(("leg", "what"), [(4, "load 634b at bus 634"), (57, "the device leg of phase")])
@pytest.mark.parametrize("n_row", [1, 40])
def test_a_power_that_is_not_finite_is_named(value, leg, what, n_row):
    feeder = load_feeder("ieee13-3ph")
    p_kw, q_kvar = np.tile(feeder.p_load_kw, (n_row, 1)), np.tile(feeder.q_load_kvar, (n_row, 1))
    q_kvar[-1, leg] = value
    with pytest.raises(
        PowerFlowError, match=rf"q_kvar of {what}.* is {re.escape(str(value))} in scenario \({n_row - 1},\)"
    ):
        solve_unbalanced(feeder, p_kw, q_kvar)


def test_a_balanced_feeder_is_refused():
    with pytest.raises(PowerFlowError, match="give a ThreePhaseFeeder, for instance load_feeder"):
        solve_unbalanced(load_feeder("toy6"), np.zeros(6), np.zeros(6))  # pyright: ignore[reportArgumentType]


def test_no_rows_at_all(feeder):
    solution = solve_unbalanced(feeder, np.zeros((0, feeder.n_leg)), np.zeros((0, feeder.n_leg)))
    assert solution.v_pu.shape == (0, feeder.n_node)
