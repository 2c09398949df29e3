"""No-load losses of transformers: a part of the losses, and of no load."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env import ThreePhaseFeeder, load_feeder
from dcgrid_env.apps.importers.opendss import read_opendss
from dcgrid_env.grid.three_phase_tables import CoreTable
from dcgrid_env.powerflow import solve_unbalanced
from dcgrid_env.powerflow.unbalanced.array_form import sweep_arrays
from docs.studies.speed.opendss_circuit import OpenDss
from helpers.places import ROOT, require

pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")

CIRCUIT = """
Clear
New Circuit.cores bus1=n basekv=12.47 pu=1.02 R1=0.1 X1=0.5 R0=0.1 X0=0.5
New Transformer.sub phases=3 xhl=8 wdg=1 bus=n conn=delta kv=12.47 kva=5000 %r=0.5
~ wdg=2 bus=low conn=wye kv=4.16 kva=5000 %r=0.5 tap=1.025 %noloadloss=0.3 %imag=0.5
New Line.l2 phases=3 bus1=low bus2=far r1=0.3 x1=0.4 c1=3 length=1
New Transformer.one phases=1 buses=[far.2 lv.2] kvs=[2.4 0.277] kvas=[100 100] xhl=3 %noloadloss=0.4
New Transformer.dd phases=3 buses=[far lvd] conns=[delta delta] kvs=[4.16 0.48] kvas=[300 300] xhl=3
~ %noloadloss=0.5 %imag=1
New Transformer.up phases=3 buses=[raised lvd] conns=[wye delta] kvs=[4.16 0.48] kvas=[300 300] xhl=3 %noloadloss=0.6
New Load.a bus1=far kv=4.16 kw=600 kvar=200 model=2
New Load.b bus1=lv.2 phases=1 kv=0.277 kw=60 pf=0.9
New Load.d bus1=lvd.1.2 phases=1 conn=delta kv=0.48 kw=40 kvar=10
Set VoltageBases=[12.47 4.16 0.48]
CalcVoltageBases
"""
EPRI = ROOT.parent / "shared" / "circuits" / "EPRITestCircuits"


def losses_kw(path):
    """OpenDSS's own losses of a script, kW."""
    from dss import DSS  # pyright: ignore[reportMissingImports]

    dss = DSS.NewContext()
    for line in (f'compile "{path}"', "Set ControlMode=OFF", "Set Tolerance=1e-10", "Set MaxIterations=300", "Solve"):
        dss.Text.Command = line
    losses: Any = dss.ActiveCircuit.Losses
    return losses[0] / 1000.0


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    path = tmp_path_factory.mktemp("cores") / "Master.dss"
    path.write_text(CIRCUIT)
    return path


@pytest.fixture(scope="module")
def feeder(script):
    return ThreePhaseFeeder.from_network(read_opendss(script).network)


@pytest.mark.slow
def test_losses_are_those_of_opendss_with_the_cores(script, feeder):
    solution = solve_unbalanced(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    theirs = losses_kw(script)
    assert solution.loss_kw == pytest.approx(theirs, rel=1e-6)
    assert sum(map(sum, feeder.network.core.p_kw)) > 0.4 * theirs
    assert feeder.network.core.name == ("sub", "one", "dd", "up")
    assert set(feeder.load_legs.row) == {0, 1, 2}


def test_a_circuit_made_of_the_tables_has_the_cores():
    base = load_feeder("ieee13-3ph")
    legs = ((5.0, 6.0, 7.0), (2.0, 0.0, 3.0)), ((8.0, 0.0, 9.0), (0.0, 4.0, 5.0))
    cores = CoreTable(("one", "two"), ("671", "675"), ("wye", "delta"), (2.4, 4.16), *legs)
    feeder = ThreePhaseFeeder.from_network(replace(base.network, core=cores))
    given = feeder.p_load_kw, feeder.q_load_kvar
    solution = solve_unbalanced(feeder, *given)
    assert solution.loss_kw > solve_unbalanced(base, *given).loss_kw + 20.0
    volts, *figures = OpenDss(feeder).solve(
        *given, feeder.v0_pu, feeder.tap_ratio(feeder.base_tap), feeder.base_capacitor_on
    )
    np.testing.assert_allclose(solution.v_re_pu + 1j * solution.v_im_pu, volts, rtol=0.0, atol=1e-7)
    assert (solution.loss_kw, solution.source_p_kw, solution.source_q_kvar) == pytest.approx(figures, abs=1e-3)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**31), scale=st.floats(0.0, 40.0))
@pytest.mark.slow
def test_the_source_gives_what_loads_draw_and_what_is_lost(feeder, seed, scale):
    rng = np.random.default_rng(seed)
    p_kw, q_kvar = np.zeros((2, 40, feeder.n_leg))
    for power in (p_kw, q_kvar):
        power[:, feeder.first_device_leg :] = rng.uniform(-scale, scale, (40, feeder.n_node))
    solution = solve_unbalanced(feeder, p_kw, q_kvar)
    assert solution.converged.all()
    np.testing.assert_allclose(solution.source_p_kw, p_kw.sum(1) + solution.loss_kw, rtol=0.0, atol=1e-3)
    idle = solve_unbalanced(feeder, 0.0 * p_kw[0], 0.0 * p_kw[0])
    assert idle.loss_kw == pytest.approx(idle.source_p_kw, abs=1e-6)
    assert idle.loss_kw == pytest.approx(sum(map(sum, feeder.network.core.p_kw)), rel=0.1)


def test_derivative_of_the_losses_and_the_array_form(feeder):
    p_kw = torch.tensor(feeder.p_load_kw, requires_grad=True)
    q_kvar = torch.tensor(feeder.q_load_kvar)
    exact: Any = {"tolerance_pu": 1e-13}
    (slope,) = torch.autograd.grad(solve_unbalanced(feeder, p_kw, q_kvar, **exact).loss_kw, p_kw)
    moved = np.tile(feeder.p_load_kw, (2 * feeder.n_leg, 1))
    moved += 0.1 * np.concatenate((np.eye(feeder.n_leg), -np.eye(feeder.n_leg)))
    loss_kw = solve_unbalanced(feeder, moved, np.tile(feeder.q_load_kvar, (len(moved), 1)), **exact).loss_kw
    differences = (loss_kw[: feeder.n_leg] - loss_kw[feeder.n_leg :]) / 0.2
    np.testing.assert_allclose(slope.numpy(), differences, rtol=1e-5, atol=1e-8)
    given: Any = tuple(np.array(a) for a in (feeder.p_load_kw, feeder.q_load_kvar, feeder.v0_pu))
    given = (*given, feeder.tap_ratio(feeder.base_tap), feeder.base_capacitor_on)
    array = sweep_arrays(feeder, given, None, 1e-13, 1000)
    solution = solve_unbalanced(feeder, *given[:2], **exact)
    np.testing.assert_allclose(array.restart, solution.restart, rtol=0.0, atol=1e-9)
    assert array.loss_kw == pytest.approx(solution.loss_kw, rel=1e-9)


def test_a_folder_keeps_the_cores(feeder, tmp_path):
    feeder.to_csv(tmp_path)
    assert (tmp_path / "cores.csv").read_text().startswith("name,bus,connection,leg_kv,kw_1,kw_2,kw_3,kvar_1")
    assert repr(ThreePhaseFeeder.from_csv(tmp_path).network) == repr(feeder.network)


@pytest.mark.slow
def test_losses_of_an_epri_circuit():
    path = require(EPRI / "ckt7" / "Master_ckt7.dss")
    feeder = ThreePhaseFeeder.from_network(read_opendss(path, allow=("capcontrol", "load")).network)
    solution = solve_unbalanced(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    assert solution.loss_kw == pytest.approx(losses_kw(path), rel=1e-3)
    assert sum(map(sum, feeder.network.core.p_kw)) > 0.2 * solution.loss_kw
