"""Parts of an OpenDSS circuit that the tables cannot represent are refused, or dropped if allowed, by name."""

import sys

import pytest

from dcgrid_env import FeederError, ThreePhaseFeeder
from dcgrid_env.apps.importers.opendss.reading import read_circuit
from helpers.opendss_imports import apart_pu, fates

dss = pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")


@pytest.mark.parametrize(("more", "said"), [
    ("New AutoTrans.a", "autotrans a: an element"),
    ("New Load.m bus1=n kv=12.47 kw=9 model=7", "load m: model 7"),
    ("New Load.n1 bus1=n.1.1 phases=1 kv=7.2 kw=9", "load n1: its nodes 1.1 give no separate legs"),
    ("New Vsource.two bus1=n basekv=12.47", "sources source, two; one can be"),
    ("New Transformer.o phases=3 buses=[n n2] kvs=[12.47 12.47] kvas=[9 9] taps=[1 1.001]\n"
     "New RegControl.o transformer=o winding=2", r"tap 1.001 is not 1 plus whole steps"),
])  # fmt: skip
def test_what_cannot_be_represented_is_refused_by_name(master, more, said):
    with pytest.raises(FeederError, match=said):
        read_circuit(master(more))


REGULATOR = "New Transformer.r phases=1 buses=[n.1 r.1] kvs=[7.2 7.2] kvas=[100 100]\nNew RegControl.r transformer=r "
LOST = {
    "New Capacitor.c bus1=n kv=12.47 kvar=90\nNew CapControl.f capacitor=c element=line.l1 type=time": "capcontrol",
    "New ISource.f bus1=n amps=20": "isource",
    "New Load.f bus1=n kv=12.47 kw=9 model=8 zipv=[1 0 0 1 0 0 0.5]": "load",
    "New Line.f bus1=far bus2=away linecode=c3": "isolated",
    f"{REGULATOR} winding=2 reversible=yes\nNew Generator.r bus1=r.1 phases=1 kv=7.2 kw=200 pf=1": "regcontrol",
    f"{REGULATOR} winding=2 inversetime=yes": "regcontrol",
    f"{REGULATOR} winding=2 cogen=yes": "regcontrol",
    f"{REGULATOR} winding=1": "regcontrol",
}


@pytest.mark.parametrize("more", LOST)
def test_what_would_be_lost_must_be_allowed(master, more):
    kind, path = LOST[more], master(more)
    with pytest.raises(FeederError, match=f"would be lost: .*{kind} .*--allow {kind} accepts") as refused:
        read_circuit(path)
    assert "\n" not in str(refused.value)
    found = read_circuit(path, allow=[kind.upper()])
    assert [row.kind for row in found.findings if row.fate == "lost"] == [kind]
    ThreePhaseFeeder.from_network(found.network)


def test_a_source_of_current_that_is_left_out_shows_in_the_voltages(master):
    found = read_circuit(master("New ISource.g bus1=n amps=50"), allow=["isource"])
    assert apart_pu(found) > 1e-4


def test_several_kinds_are_asked_for_at_once(master):
    more = "New IndMach012.f bus1=n kv=12.47 kw=9\nNew ISource.p bus1=n amps=5"
    with pytest.raises(FeederError, match=r"--allow indmach012,isource accepts"):
        read_circuit(master(more), allow=["indmach012"])
    with pytest.raises(FeederError, match=r"'fuses' is no kind of loss; choose among .*capcontrol"):
        read_circuit(master(more), allow=["fuses"])


def test_what_is_disabled_or_beyond_an_open_switch_is_left_out(master):
    more = "New Load.off bus1=n kv=12.47 kw=9\nDisable Load.off\nNew Line.s bus1=n bus2=far switch=yes\nOpen Line.s 1"
    found = read_circuit(master(more))
    assert {("load", "off", "nothing lost"), ("isolated", "line s", "nothing lost")} <= fates(found)
    assert "far" not in found.network.node.bus
    assert apart_pu(found) < 1e-8


def test_what_opendss_refuses_names_file_and_line(master):
    with pytest.raises(FeederError, match=r"Master.dss, line 9: OpenDSS refuses the command: .*nowhere") as refused:
        read_circuit(master("New Load.x bus1=n kv=1 kw=1 daily=nowhere"))
    assert "\n" not in str(refused.value)
    with pytest.raises(FeederError, match="there is no file"):
        read_circuit("nowhere.dss")
    with pytest.raises(FeederError, match="defines 0 circuits"):
        read_circuit(master(circuit="", end=""))


def test_a_circuit_that_opendss_cannot_solve_has_no_voltages(master):
    assert read_circuit(master("Edit Load.d kw=1e6 vminpu=0.002 vlowpu=0.001")).v_pu == {}


def test_without_opendssdirect_the_extra_is_named(master, monkeypatch):
    monkeypatch.setitem(sys.modules, "opendssdirect", None)
    with pytest.raises(FeederError, match=r"OpenDSSDirect.py.*\[opendss\]"):
        read_circuit(master())
