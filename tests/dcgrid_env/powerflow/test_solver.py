"""Solvers behind one protocol: found by the kind of feeder, with what devices change of the grid and a restart."""

import inspect

import numpy as np
import pytest
import torch

from dcgrid_env import Feeder, PowerFlowError, distflow, lindistflow
from dcgrid_env.powerflow import Control, Solver, solver_for

METHODS = {"distflow": distflow, "lindistflow": lindistflow}
BOTH = pytest.mark.parametrize("method", METHODS)
KINDS = pytest.mark.parametrize("kind", [np.asarray, torch.tensor])


def same(a, b):
    return all(np.asarray(x).tobytes() == np.asarray(y).tobytes() for x, y in zip(a, b, strict=True))


@BOTH
@KINDS
def test_is_the_public_method_to_the_bit(feeder, random_loads, method, kind):
    loads = [kind(a) for a in random_loads(feeder, 12, seed=60)]
    assert same(solver_for(feeder, method)(feeder, *loads), METHODS[method](feeder, *loads))


@BOTH
def test_solvers_take_the_arguments_of_the_protocol(toy6, method):
    wanted = list(inspect.signature(Solver.__call__).parameters)[1:]
    assert list(inspect.signature(solver_for(toy6, method)).parameters) == wanted


@BOTH
@KINDS
@pytest.mark.parametrize("by_row", [True, False])
def test_switched_shunts_are_injected(feeder, random_loads, method, kind, by_row):
    p_kw, q_kvar, v0_pu = random_loads(feeder, 12, seed=61)
    shunt_kvar = np.random.default_rng(62).uniform(0.0, 50.0, q_kvar.shape if by_row else q_kvar.shape[1:])
    found = solver_for(feeder, method)(
        feeder, *map(kind, (p_kw, q_kvar, v0_pu)), control=Control(shunt_kvar=kind(shunt_kvar))
    )
    assert same(found, METHODS[method](feeder, *map(kind, (p_kw, q_kvar - shunt_kvar, v0_pu))))


def test_a_switched_shunt_raises_the_voltage(toy6, base):
    solve = solver_for(toy6, "distflow")
    closed = solve(toy6, *base, source_voltage_pu=1.0, control=Control(shunt_kvar=100.0 * np.eye(6)[2]))
    assert (closed.v_pu - solve(toy6, *base, source_voltage_pu=1.0).v_pu)[2] == pytest.approx(
        0.1 * 0.04, rel=0.1
    )  # two branches' x


@BOTH
def test_a_control_that_sets_nothing_changes_nothing(toy6, base, method):
    solve = solver_for(toy6, method)
    assert same(solve(toy6, *base, source_voltage_pu=1.0, control=Control()), solve(toy6, *base, source_voltage_pu=1.0))


@BOTH
def test_a_tap_is_refused(toy6, base, method):
    with pytest.raises(PowerFlowError, match=r"'toy6': tap_ratio is .*no regulator; leave tap_ratio at None"):
        solver_for(toy6, method)(toy6, *base, source_voltage_pu=1.0, control=Control(tap_ratio=np.array([1.00625])))


@BOTH
@pytest.mark.parametrize("shape", [(5,), (), (2, 6), (6, 1)])
def test_shunts_of_the_wrong_shape_are_refused(toy6, base, method, shape):
    with pytest.raises(PowerFlowError, match=r"'toy6': shunt_kvar has shape .*give one figure for each node, \(6,\)"):
        solver_for(toy6, method)(toy6, *base, source_voltage_pu=1.0, control=Control(shunt_kvar=np.zeros(shape)))


def test_shunts_that_are_no_numbers_are_refused(toy6, base):
    with pytest.raises(PowerFlowError, match=r"'toy6': shunt_kvar is .*give reactive injections alone"):
        solver_for(toy6, "distflow")(
            toy6, *base, source_voltage_pu=1.0, control=Control(shunt_kvar=np.array(["on"] * 6))
        )


@KINDS
def test_a_restart_saves_sweeps_and_is_a_warm_start(feeder, random_loads, kind):
    p_kw, q_kvar, v0_pu = (kind(a) for a in random_loads(feeder, 12, seed=63))
    solve = solver_for(feeder, "distflow")
    before = solve(feeder, 0.999 * p_kw, 0.999 * q_kvar, v0_pu)
    again = solve(feeder, p_kw, q_kvar, v0_pu, start=before.restart)
    assert (np.asarray(again.iterations) < np.asarray(solve(feeder, p_kw, q_kvar, v0_pu).iterations)).all()
    assert same(again, distflow(feeder, p_kw, q_kvar, v0_pu, warm=before))


@BOTH
def test_zeros_are_no_start(feeder, random_loads, method):
    loads, solve = random_loads(feeder, 12, seed=64), solver_for(feeder, method)
    cold = solve(feeder, *loads)
    assert same(solve(feeder, *loads, start=0.0 * cold.restart), cold)


def test_a_kind_of_feeder_of_ones_own_has_the_solvers_of_its_base(toy6):
    class Own(Feeder):
        pass

    own = Own(**{name: getattr(toy6, name) for name in Feeder.__dataclass_fields__})
    assert solver_for(own, "distflow") is solver_for(toy6, "distflow")


def test_an_unknown_method_lists_those_there_are(toy6):
    with pytest.raises(PowerFlowError, match=r"'toy6': no power flow 'newton'; choose one of distflow, lindistflow"):
        solver_for(toy6, "newton")


@pytest.mark.parametrize("feeder", [None, "toy6", {"toy6": 1}])
def test_what_is_no_feeder_has_no_solver(feeder):
    with pytest.raises(PowerFlowError, match=r"feeder is .*; give a Feeder"):
        solver_for(feeder, "distflow")
