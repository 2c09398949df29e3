"""Elements in every connection agree with OpenDSS: those of the tables, and those that become admittances."""

import numpy as np
import pytest

from dcgrid_env import ThreePhaseFeeder
from dcgrid_env.apps.importers.opendss.reading import read_circuit
from dcgrid_env.devices.tap_changer.relay import relay_settings, relay_volts
from dcgrid_env.powerflow import solve_unbalanced
from helpers.opendss_imports import apart_pu, fates

dss = pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")

CENTRE_TAP = """New Transformer.ct phases=1 windings=3 buses=[n.2 s.1.0 s.0.2] kvs=[7.2 0.12 0.12] kvas=[25 25 25]
~ xhl=2.04 xht=2.04 xlt=1.36 %rs=[0.6 1.2 1.2] %noloadloss=0.2
New Linecode.tp nphases=2 rmatrix=(1.54 | 0.54 1.54) xmatrix=(0.6 | 0.4 0.6) units=mi
New Line.drop bus1=s.1.2 bus2=h.1.2 linecode=tp length=80 units=ft phases=2
"""
CASES = {
    "centre tap, legs and 240 V": CENTRE_TAP + "New Load.one bus1=h.1 phases=1 kv=0.12 kw=4 kvar=1\n"
    "New Load.two bus1=h.2 phases=1 kv=0.12 kw=2\nNew Load.both bus1=h.1.2 phases=1 kv=0.24 kw=6 kvar=2",
    "wye-g / delta": "New Transformer.yd phases=3 buses=[n y] conns=[wye delta] kvs=[12.47 0.48] kvas=[500 500] xhl=4\n"
    "New Load.y bus1=y conn=delta kv=0.48 kw=200 kvar=90",
    "floating star": "New Transformer.un phases=3 buses=[n.1.2.3.4 y] conns=[wye delta]\n"
    "~ kvs=[12.47 0.48] kvas=[500 500]\n"
    "New Load.y bus1=y.1.2 phases=1 conn=delta kv=0.48 kw=90 kvar=30",
    "star with a neutral reactor": "New Transformer.zn phases=3 buses=[n y.1.2.3.4] conns=[delta wye]\n"
    "~ kvs=[12.47 4.16]\n"
    "~ kvas=[900 900]\nNew Reactor.n bus1=y.4 bus2=y.0 phases=1 x=0.5\nNew Load.y bus1=y.1 phases=1 kv=2.4 kw=200",
    "open wye / open delta": "New Transformer.oa phases=1 buses=[n.1 y.1.2] kvs=[7.2 0.24] kvas=[50 50]\n"
    "New Transformer.ob phases=1 buses=[n.2 y.2.3] kvs=[7.2 0.24] kvas=[50 50]\n"
    "New Load.y bus1=y conn=delta kv=0.24 kw=40 kvar=10",
    "three windings": "New Transformer.t3 phases=3 windings=3 buses=[n y z] conns=[wye wye delta]\n"
    "~ kvs=[12.47 4.16 0.48]\n"
    "~ kvas=[900 900 300] xhl=5 xht=7 xlt=4\nNew Load.y bus1=y kv=4.16 kw=300\n"
    "New Load.z bus1=z conn=delta kv=0.48 kw=90",
    "turned phases": "New Transformer.tr phases=3 buses=[n y.2.3.1] conns=[delta wye] kvs=[12.47 0.48] kvas=[500 500]\n"
    "New Load.y bus1=y.1 phases=1 kv=0.277 kw=60",
    "unlike units": "New Transformer.a phases=1 buses=[n.1 y.1] kvs=[7.2 0.277] kvas=[15 15] xhl=2\n"
    "New Transformer.b phases=1 buses=[n.2 y.2] kvs=[7.2 0.277] kvas=[37.5 37.5] xhl=3\n"
    "New Load.y bus1=y.1.2 phases=2 kv=0.48 kw=30",
    "neutral conductor": "New Line.four phases=4 bus1=n.1.2.3.4 bus2=y.1.2.3.4 length=0.2 units=km\n"
    "~ rmatrix=(0.4 | 0.1 0.4 | 0.1 0.1 0.4 | 0.1 0.1 0.1 0.6)\n"
    "~ xmatrix=(0.9 | 0.4 0.9 | 0.4 0.4 0.9 | 0.4 0.4 0.4 1.0)\n"
    "New Reactor.g bus1=y.4 phases=1 r=5 x=0.01\nNew Reactor.gn bus1=n.4 phases=1 r=2 x=0.01\n"
    "New Load.y bus1=y.1.4 phases=1 kv=7.2 kw=300 kvar=50",
    "phases that change": "New Line.turn bus1=n bus2=y.2.3.1 linecode=c3\nNew Load.y bus1=y.1 phases=1 kv=7.2 kw=200",
    "a loop": "New Line.loop bus1=src bus2=n linecode=c3 length=3000 units=ft",
    "an open phase": "Open Line.l2 1 2\nEdit Load.d conn=wye phases=1 bus1=n.1 kv=7.2 kw=300",
    "series capacitor": "New Capacitor.s bus1=n bus2=y kv=12.47 kvar=9000\nNew Load.y bus1=y kv=12.47 kw=200",
    "capacitor with a reactor": "New Capacitor.r bus1=n kv=12.47 kvar=90 r=1 xl=2",
    "shunt reactor": "New Reactor.f bus1=n kv=12.47 kvar=100",
    "phases by a line and a transformer": "New Line.a phases=1 bus1=n.1 bus2=y.1 r1=1 x1=1\n"
    "New Transformer.bc phases=2 buses=[n.2.3 y.2.3]\n"
    "~ kvs=[12.47 12.47] kvas=[900 900]\nNew Load.y bus1=y kv=12.47 kw=99",
    "exponents": "New Load.e bus1=n kv=12.47 kw=400 kvar=100 model=4 cvrwatts=0.8 cvrvars=3",
    "exponents below their limit": "New Load.e bus1=n kv=13.5 kw=900 kvar=300 model=4 cvrwatts=0.8 cvrvars=2",
    "exponents above their limit": "New Load.e bus1=n kv=11.5 kw=900 kvar=300 model=4",
    "motor": "New Load.e bus1=n kv=12.47 kw=400 kvar=100 model=3",
    "fault resistance": "New Fault.f bus1=n.1 phases=1 r=20",
    "node numbers beyond 26": "New Line.far phases=1 bus1=n.1 bus2=y.31 r1=1 x1=1\n"
    "New Load.y bus1=y.31 phases=1 kv=7.2 kw=90",
}


@pytest.mark.parametrize("case", CASES)
def test_every_connection_agrees_with_opendss(case, master, tmp_path):
    found = read_circuit(master(CASES[case]))
    assert not [row for row in found.findings if row.fate in ("lost", "refused")]
    assert apart_pu(found) < 2e-8
    feeder = ThreePhaseFeeder.from_network(found.network)
    feeder.to_csv(tmp_path / "tables")
    assert repr(ThreePhaseFeeder.from_csv(tmp_path / "tables").network) == repr(feeder.network)  # NaN differs from NaN


def test_a_neutral_is_a_node_but_no_voltage_is_judged_there(master):
    feeder = ThreePhaseFeeder.from_network(read_circuit(master(CASES["neutral conductor"])).network)
    assert "y.d" in feeder.node_ids
    judged = [feeder.node_ids[node] for node in feeder.load_nodes]
    assert "y.a" in judged
    assert not [name for name in judged if name.endswith(".d")]
    assert [feeder.node_ids[node] for node in feeder.nodes_of("y")] == ["y.a", "y.b", "y.c"]


@pytest.mark.parametrize("tap", [1.0, 1.0125, 0.9625])
@pytest.mark.parametrize(("script", "connection"), [
    ("New Transformer.ra phases=1 buses=[n.1.2 r.1.2] kvs=[12.47 12.47] kvas=[2000 2000] xhl=1\n"
     "New Line.jumper phases=1 bus1=n.2 bus2=r.2 r1=0.001 x1=0.001\n"
     "New Load.r bus1=r.1.2 phases=1 conn=delta kv=12.47 kw=500 kvar=200", "delta"),
    ("New Transformer.ra phases=3 buses=[n r.1.2.3.4] conns=[delta wye] kvs=[12.47 4.16] kvas=[2000 2000]\n"
     "New Reactor.n bus1=r.4 phases=1 x=0.5\nNew Load.r bus1=r.1 phases=1 kv=2.4 kw=300", "ad bd cd"),
])  # fmt: skip
def test_a_regulator_between_nodes_measures_its_winding(master, script, connection, tap):
    control = "\nNew RegControl.ra transformer=ra winding=2 vreg=122 band=2 ptratio=60 delay=30"
    control += f"\nEdit Transformer.ra wdg=2 tap={tap}"
    found = read_circuit(master(script + control))
    assert found.network.regulator.connection == (connection,)
    assert found.network.regulator.tap == (round((tap - 1.0) / 0.00625),)
    assert apart_pu(found) < 1e-7
    feeder = ThreePhaseFeeder.from_network(found.network)
    s = solve_unbalanced(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    other = "r.b" if connection == "delta" else "r.d"
    across = found.v_pu["r.a"] - found.v_pu[other]
    base_v = 1000.0 * feeder.base_kv_ln[feeder.index("r")]
    assert relay_volts(relay_settings(feeder), s) == pytest.approx(abs(across) * base_v / 60.0, abs=1e-3)


def test_ratings_of_a_split_phase_transformer(master):
    found = read_circuit(master(CASES["centre tap, legs and 240 V"]))
    feeder = ThreePhaseFeeder.from_network(found.network)
    assert feeder.rating_a is not None
    amps = dict(zip(feeder.node_ids, feeder.rating_a.tolist(), strict=True))
    assert amps["s.a"] == pytest.approx(25.0 / 0.24)
    assert ("transformer", "ct", "taken") in fates(found)
    assert np.isnan(amps["h.a"])
