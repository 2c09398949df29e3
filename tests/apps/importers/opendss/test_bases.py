"""Base voltages that a script leaves out, and frequencies that contradict each other."""

import pytest

from dcgrid_env import FeederError
from dcgrid_env.apps.importers.opendss.reading import read_circuit
from helpers.opendss_imports import apart_pu

dss = pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")

TOWN = """New Transformer.sub buses=[n mv] conns=[delta wye] kvs=[12.47 4.16] kvas=[900 900] xhl=5
New Transformer.lv buses=[mv lv] conns=[delta wye] kvs=[4.16 0.48] kvas=[300 300] xhl=4
New Transformer.one phases=1 buses=[mv.2 one.2] kvs=[2.4 0.24] kvas=[25 25] xhl=2
New Transformer.ct phases=1 windings=3 buses=[mv.1 s.1.0 s.0.2] kvs=[2.4 0.12 0.12] kvas=[25 25 25] xhl=2 xht=2 xlt=1
New Load.lv bus1=lv kv=0.48 kw=90
New Load.one bus1=one.2 phases=1 kv=0.24 kw=9
New Load.s bus1=s.1 phases=1 kv=0.12 kw=4
"""
RIGHT = "Set VoltageBases=[12.47 4.16 0.48 0.4157 0.208]\nCalcVoltageBases\n"


def bases(network):
    return dict(zip(network.node.bus, network.node.base_kv_ln, strict=True))


@pytest.mark.parametrize("end", ["", "Solve\n", "SetkVBase bus=lv kVLL=0.48\n"])
def test_bases_that_are_not_set_are_those_of_opendss_with_the_right_list(end, master):
    right = bases(read_circuit(master(TOWN, end=RIGHT)).network)
    found = read_circuit(master(TOWN, end=end))
    assert bases(found.network) == pytest.approx(right, rel=2e-3)
    assert apart_pu(found) < 1e-7
    [row] = [row for row in found.findings if row.kind == "bus"]
    assert "12.47, " in row.shown or "12.4708" in row.shown


def test_a_list_without_its_command_is_the_scripts(master):
    found = read_circuit(master(TOWN, end="Set VoltageBases=[13.2 4.8 0.5 0.4 0.2]\n"))
    assert sorted({round(kv * 3.0**0.5, 3) for kv in bases(found.network).values()}) == [0.2, 0.4, 0.5, 4.8, 13.2]


def test_a_base_that_is_set_is_kept(master):
    found = read_circuit(master(TOWN, end="CalcVoltageBases\nSet VoltageBases=[12.47 4.16 0.48 0.4157 0.208]\n"
                         "CalcVoltageBases\nSetkVBase bus=lv kVLL=0.44\n"))  # fmt: skip
    assert bases(found.network)["lv"] == pytest.approx(0.44 / 3.0**0.5)


@pytest.mark.parametrize("more", ["Set DefaultBaseFrequency=50\n", "Set DefaultBaseFrequency=50\nSet frequency=50\n"])
def test_a_frequency_that_is_set_behind_the_circuit_is_named(more, master):
    message = (
        "source source: its basefreq is 60 Hz, but the circuit is solved at 50 Hz, where OpenDSS has 0 V at every bus; "
        "put Set DefaultBaseFrequency=50 before New Circuit"
    )
    with pytest.raises(FeederError) as refused:
        read_circuit(master(more))
    assert str(refused.value) == message
    assert read_circuit(master("Edit Vsource.source basefreq=50\n" + more)).v_pu


def test_a_load_shape_may_have_a_blank_before_its_columns(master, tmp_path):
    (tmp_path / "shape.csv").write_text("t,p,q\n0,0.5,0.2\n1,0.6,0.3\n2,0.7,0.3\n3,0.8,0.4\n")
    shape = (
        "New Loadshape.s npts=4 minterval=15 pmult=(file=shape.csv {0}col=2, header=yes) qmult=(file=shape.csv ,col=3,"
    )
    found = read_circuit(master(f"{shape.format(',')} header=yes)\nNew Load.s bus1=n kv=12.47 kw=90 daily=s"))
    [profiles] = [one for one in found.profiles if one.mode == "daily"]
    assert sorted(value for row in profiles.values for value in row) == [0.2, 0.3, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]
