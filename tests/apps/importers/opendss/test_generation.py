"""Generators, PV systems and storages as loads that inject: OpenDSS's voltages, and its power at other voltages."""

import numpy as np
import pytest

from dcgrid_env import FeederError, ThreePhaseFeeder
from dcgrid_env.apps.importers.opendss.reading import read_circuit
from dcgrid_env.powerflow import solve_unbalanced
from helpers.opendss_imports import apart_pu, fates

pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")

DELTA = """
New Transformer.e xhl=5.75 kva=750 conns=[wye delta]
~ wdg=1 bus=n.1.2.3.4 kv=12.47
~ wdg=2 bus=nd kv=0.48
New Line.ld bus1=nd bus2=ng switch=yes
"""
CASES = {
    "generator": "New Generator.x bus1=n kv=12.47 kw=900 kvar=200",
    "in delta": "New Generator.x bus1=n kv=12.47 kw=900 pf=0.9 conn=delta",
    "of one phase, an impedance": "New Generator.x bus1=n.2 phases=1 kv=7.2 kw=300 model=2",
    "fixed": "New Generator.x bus1=n kv=12.47 kw=900 model=4 status=fixed",
    "that holds the voltage": "New Generator.x bus1=n kv=12.47 kw=900 model=3 vpu=1.02 maxkvar=500",
    "above its limit": "New Generator.x bus1=n kv=9 kw=900 kvar=200",
    "below its limit": "New Generator.x bus1=n kv=16 kw=900 kvar=200",
    "behind a floating transformer": f"{DELTA}New Generator.x bus1=ng kv=0.48 kw=620 kvar=30 conn=delta model=7",
    "photovoltaics": "New PVSystem.x bus1=n kv=12.47 kva=1000 pmpp=1200 irradiance=0.8 pf=0.95",
    "photovoltaics between phases": "New PVSystem.x bus1=n.1.2 phases=1 kv=12.47 kva=100 pmpp=100 irradiance=0.8",
    "discharging": "New Storage.x bus1=n kv=12.47 kwrated=300 kwhrated=1000 state=discharging",
    "charging": "New Storage.x bus1=n kv=12.47 kwrated=300 kwhrated=1000 %stored=50 state=charging",
    "idling": "New Storage.x bus1=n kv=12.47 kwrated=300 kwhrated=1000",
    "of another rated voltage": f"{DELTA}New Storage.x bus1=nd kwrated=250 kwhrated=500 state=charging %stored=50",
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.slow
def test_voltages_are_those_of_opendss(master, case):
    found = read_circuit(master(CASES[case]))
    kind = CASES[case].rpartition("New ")[2].partition(".")[0].lower()
    assert (kind, "x", "taken") in fates(found)
    without = ThreePhaseFeeder.from_network(read_circuit(master(DELTA if DELTA in CASES[case] else "")).network)
    assert len(ThreePhaseFeeder.from_network(found.network).load_legs.bus) > len(without.load_legs.bus)
    assert apart_pu(found) < 1e-6


@pytest.mark.parametrize(("kv", "pu"), [(12.47, 1.04), (9.0, 1.04), (16.0, 0.96)])
def test_within_limits_the_power_is_constant_and_beyond_them_that_of_an_impedance(master, kv, pu):
    """The law is that of OpenDSS when the source's voltage changes after the import."""
    script = f"New Generator.x bus1=n kv={kv} kw=900 kvar=200\nEdit Vsource.source pu={{}}"
    feeder = ThreePhaseFeeder.from_network(read_circuit(master(script.format(1.02))).network)
    other = read_circuit(master(script.format(pu)))
    solution = solve_unbalanced(feeder, feeder.p_load_kw, feeder.q_load_kvar, pu)
    v = dict(zip(feeder.node_ids, solution.v_re_pu + 1j * solution.v_im_pu, strict=True))
    assert max(abs(v[node] - theirs) for node, theirs in other.v_pu.items()) < 1e-6


def test_a_generator_without_supply_is_named(master):
    with pytest.raises(FeederError, match="isolated generator x: without supply"):
        read_circuit(master("New Generator.x bus1=far kv=12.47 kw=9"))


def test_units_with_an_open_phase_are_refused(master):
    with pytest.raises(FeederError, match="give no separate legs, or one is open"):
        read_circuit(master("New Generator.x bus1=n kv=12.47 kw=9\nOpen Generator.x 1 1"))


def test_the_loads_table_has_their_sign_and_limits(master):
    table = read_circuit(master(CASES["generator"])).network.phase_load
    row = table.name.index("generator.x")
    np.testing.assert_allclose(table.p_kw[row], -300.0, rtol=1e-9)
    np.testing.assert_allclose(table.q_kvar[row], -200.0 / 3.0, rtol=1e-9)
    assert (table.model[row], table.vmin_pu[row], table.vmax_pu[row]) == ("PQ", 0.9, 1.1)
