"""The reference solvers solve the same feeder as distflow, so that their speeds compare."""

from __future__ import annotations

import numpy as np
import pytest

from dcgrid_env import Feeder, distflow, load_feeder
from dcgrid_env.core.suggestions import from_clone
from docs.studies.speed.reference_solvers import REFERENCE_SOLVERS, ReferenceSolver, missing

N_ROW = 6
# p.u. The closed switches of ieee123 are a reactance of 1e-7 p.u. in lightsim2grid and OpenDSS and drop up to 3e-7. All
# else is less: OpenDSS's source impedance (1e12 MVA), float32 loads in lightsim2grid's single solve.
CLOSE = 1e-6


@pytest.fixture(params=["ieee33", "ieee123"])
def feeder(request: pytest.FixtureRequest) -> Feeder:
    return load_feeder(request.param)


@pytest.fixture(params=REFERENCE_SOLVERS)
def solver(request: pytest.FixtureRequest, feeder: Feeder) -> ReferenceSolver:
    """Each reference solver, at a substation voltage of 1.04 p.u."""
    lacking = missing(request.param)
    if lacking:
        pytest.skip(f"{', '.join(lacking)} not installed ({from_clone('bench')})")
    return REFERENCE_SOLVERS[request.param][0](feeder, 1.04)


@pytest.fixture
def loads(feeder: Feeder) -> tuple[np.ndarray, np.ndarray]:
    """Random loads (row, bus) of both signs; the last row carries none."""
    rng = np.random.default_rng(3)
    p_kw = feeder.p_load_kw * rng.uniform(-0.5, 1.5, (N_ROW, feeder.n_bus))
    q_kvar = feeder.q_load_kvar * rng.uniform(-0.5, 1.5, (N_ROW, feeder.n_bus)) - feeder.capacitor_kvar
    p_kw[:, -1], q_kvar[:, 0] = 100.0, 50.0  # an end bus that always draws; a load at the substation itself
    p_kw[-1], q_kvar[-1] = 0.0, 0.0
    return p_kw, q_kvar


@pytest.mark.slow
def test_solves_agree_with_distflow(solver, feeder, loads):
    p_kw, q_kvar = loads
    ours = distflow(feeder, p_kw, q_kvar, 1.04, tolerance_kva=1e-8)
    assert ours.converged.all()
    assert np.ptp(ours.v_pu[0]) > 1e-3
    for row in (0, 3, 5, 0):  # the first again: nothing is left over from the rows between
        v_pu = solver.solve(p_kw[row], q_kvar[row])
        assert v_pu.shape == (feeder.n_bus,)
        np.testing.assert_allclose(v_pu, ours.v_pu[row], rtol=0.0, atol=CLOSE)
    for n_row in (N_ROW, 2) if solver.solve_batch else ():
        v_pu = solver.solve_batch(p_kw[:n_row], q_kvar[:n_row])
        np.testing.assert_allclose(v_pu, ours.v_pu[:n_row], rtol=0.0, atol=CLOSE)


@pytest.mark.slow
def test_the_substation_voltage_is_the_feeders_own_unless_given(feeder):
    lacking = missing("pandapower, defaults")
    if lacking:
        pytest.skip(f"{', '.join(lacking)} not installed ({from_clone('bench')})")
    v_pu = REFERENCE_SOLVERS["pandapower, defaults"][0](feeder, None).solve(
        np.zeros(feeder.n_bus), np.zeros(feeder.n_bus)
    )
    np.testing.assert_allclose(v_pu, feeder.v0_pu, rtol=0.0, atol=1e-9)


def test_the_modules_that_are_not_installed_are_listed(monkeypatch):
    monkeypatch.setitem(REFERENCE_SOLVERS, "none", (REFERENCE_SOLVERS["OpenDSS"][0], ("sys", "no_such_module")))
    assert missing("none") == ["no_such_module"]
