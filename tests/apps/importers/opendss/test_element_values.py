"""Values that OpenDSS computes from properties nobody reads: each row has the admittance of its element."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from dcgrid_env import FeederError, ThreePhaseFeeder
from dcgrid_env.apps.importers.opendss import dss_transformers, reading
from dcgrid_env.apps.importers.opendss.reading import read_circuit
from dcgrid_env.powerflow import solve_unbalanced
from helpers.opendss_imports import apart_pu, fates

dss = pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")

CAPACITORS = {
    "by capacitance": "New Capacitor.c bus1=n kv=12.47 cuf=30",
    "by capacitance, without a voltage, on a low-voltage bus": "New Transformer.t buses=[n low] kvs=[12.47 0.48]\n"
    "~ kvas=[500 500] xhl=4\nNew Capacitor.c bus1=low cuf=900",
    "by a matrix": "New Capacitor.c bus1=n kv=12.47 cmatrix=(9 | -1 10 | -1 -2 11)",
    "steps that share one kvar": "New Capacitor.c bus1=n kv=12.47 numsteps=4 kvar=300",
    "steps of which one is off": "New Capacitor.c bus1=n kv=12.47 numsteps=3 cuf=[5 9 14] states=[1 0 1]",
    "with a reactance": "New Capacitor.c bus1=n kv=12.47 kvar=600 xl=8",
    "tuned steps": "New Capacitor.c bus1=n kv=12.47 numsteps=2 kvar=[300 300] harm=[5 7]",
    "delta of another frequency": "New Capacitor.c bus1=n kv=12.47 conn=delta kvar=600 basefreq=50",
    "between two phases": "New Capacitor.c bus1=n.1.2 bus2=n.2.3 phases=2 kv=12.47 cuf=9",
    "floating star": "New Capacitor.c bus1=n bus2=n.4.4.4 kv=12.47 kvar=600",
    "opened by its control": "New Capacitor.c bus1=n kv=12.47 cuf=30\nOpen Capacitor.c 1",
    "one phase open": "New Capacitor.c bus1=n kv=12.47 cuf=30\nOpen Capacitor.c 1 2",
}
FREQUENCIES = {
    "transformer": "New Transformer.t buses=[n low] conns=[delta wye] kvs=[12.47 0.48] kvas=[500 500] xhl=9\n"
    "~ basefreq=50 %imag=3 %noloadloss=1\nNew Load.z bus1=low kv=0.48 kw=400 kvar=200",
    "regulated transformer": "New Transformer.t buses=[n low] conns=[delta wye] kvs=[12.47 4.16] kvas=[900 900] xhl=9\n"
    "~ basefreq=50\nNew RegControl.r transformer=t winding=2 vreg=120 band=2 ptratio=20\n"
    "New Load.z bus1=low kv=4.16 kw=400 kvar=200",
    "three windings": "New Transformer.t windings=3 buses=[n y z] conns=[delta wye wye] kvs=[12.47 4.16 0.48]\n"
    "~ kvas=[900 900 300] xhl=5 xht=7 xlt=4 basefreq=50\nNew Load.y bus1=y kv=4.16 kw=300\n"
    "New Load.z bus1=z kv=0.48 kw=90",
    "series reactor": "New Reactor.t bus1=n bus2=z r=1 x=9 basefreq=50\nNew Load.z bus1=z kv=12.47 kw=400 kvar=200",
    "shunt reactor": "New Reactor.t bus1=n kv=12.47 kvar=300 basefreq=50",
    "line": "New Line.t bus1=n bus2=z r1=1 x1=3 c1=90 length=2 basefreq=50\nNew Load.z bus1=z kv=12.47 kw=400 kvar=200",
    "loads": "New Load.t bus1=n kv=12.47 kw=400 kvar=200 basefreq=50\nNew Load.z bus1=n kv=12.47 kw=40 kvar=60 model=2 "
    "basefreq=50",
}


@pytest.mark.parametrize("case", CAPACITORS)
def test_capacitors_have_the_voltages_of_opendss(case, master):
    found = read_circuit(master(CAPACITORS[case]))
    assert not [row for row in found.findings if row.fate in ("lost", "refused")]
    assert apart_pu(found) < 1e-8


def test_the_susceptance_of_a_capacitor_is_that_of_its_capacitance(master):
    network = read_circuit(master(CAPACITORS["by capacitance"])).network
    assert network.capacitor.kvar[0] == pytest.approx([2e-6 * np.pi * 60.0 * 30.0 * 12.47**2 / 3.0 * 1000.0] * 3)


def test_a_bank_with_other_kvar_than_its_property_is_reported(master):
    found = read_circuit(master(CAPACITORS["steps that share one kvar"]))
    assert sum(map(sum, found.network.capacitor.kvar)) == pytest.approx(1200.0)  # OpenDSS: each step has the first kvar
    [text] = [row.text for row in found.findings if (row.kind, row.fate) == ("capacitor", "nothing lost")]
    assert "1200 kvar" in text
    assert "its property kvar is 300" in text


def test_reading_the_steps_leaves_the_circuit_as_it_was(master):
    path = master("New Capacitor.c bus1=n kv=12.47 numsteps=3 cuf=[5 9 14] states=[0 1 0]\nOpen Capacitor.c 1")
    assert read_circuit(path).network.capacitor.state == ("off",) * 3
    closed = read_circuit(master("New Capacitor.c bus1=n kv=12.47 numsteps=3 cuf=[5 9 14] states=[0 1 0]"))
    assert closed.network.capacitor.state == ("off", "on", "off")


def test_reading_the_steps_keeps_the_voltages_that_generation_depends_on(master):
    found = read_circuit(master("New Capacitor.c bus1=n kv=12.47 cuf=9\nNew Generator.g bus1=n kv=12.47 kw=90 kvar=30"))
    [row] = [k for k, name in enumerate(found.network.phase_load.name) if name == "generator.g"]
    assert found.network.phase_load.p_kw[row] == pytest.approx((-30.0,) * 3)
    assert apart_pu(found) < 1e-8


def test_reading_the_steps_leaves_the_power_flow_without_lost_elements_right(master):
    lost = "New Capacitor.c bus1=n kv=12.47 cuf=9\nNew ISource.i bus1=n amps=1"
    found = read_circuit(master(lost), allow=["isource"])
    assert apart_pu(dataclasses.replace(found, v_pu=found.v_pu_without)) < 1e-8


@pytest.mark.parametrize("case", FREQUENCIES)
def test_elements_of_another_frequency_have_the_voltages_of_opendss(case, master):
    found = read_circuit(master(FREQUENCIES[case]))
    assert apart_pu(found) < 2e-8


def test_a_transformer_of_another_frequency_keeps_its_row(master):
    network = read_circuit(master(FREQUENCIES["transformer"])).network
    assert network.transformer.x_percent == pytest.approx((9.0 * 60.0 / 50.0,))
    assert not len(network.admittance)


def test_an_element_whose_row_differs_becomes_an_admittance(master, monkeypatch):
    """The reader is made to misread the reactance, as it would misread a property that it does not know."""
    right = dss_transformers.transformer_joint

    def wrong(*arguments):
        joint: Any = right(*arguments)
        return dataclasses.replace(joint, values=joint.values | {"x_percent": 1.0})

    monkeypatch.setattr(reading, "transformer_joint", wrong)
    found = read_circuit(master("New Transformer.t buses=[n low] kvs=[12.47 0.48] kvas=[500 500] xhl=6"))
    assert found.network.admittance.name == ("transformer.t",)
    [text] = [row.text for row in found.findings if (row.kind, row.fate) == ("transformer", "taken")]
    assert "would not have its admittances" in text
    assert apart_pu(found) < 1e-8


def test_an_element_that_no_table_reproduces_is_refused_by_name(master, monkeypatch):
    monkeypatch.setattr(reading, "unlike_elements", lambda *_: ["line.l2"])
    with pytest.raises(FeederError, match=r"circuit 'town': line.l2: the tables give other admittances than OpenDSS"):
        read_circuit(master())


def test_the_charging_of_short_cables_is_kept(master):
    short = "New Line.s{0} bus1={1} bus2=s{0} r1=1e-5 x1=1e-5 r0=1e-5 x0=1e-5 c1=400 c0=400\n"
    lines = "".join(short.format(k, f"s{k - 1}" if k else "n") for k in range(6))
    found = read_circuit(master(lines))
    assert found.network.phase_line.b_us[-1][0][0] == pytest.approx(2e-3 * np.pi * 60.0 * 400.0, rel=1e-6)
    assert apart_pu(found) < 1e-8


def test_an_open_line_keeps_the_charging_at_its_other_end(master):
    found = read_circuit(master("New Line.far bus1=n bus2=m linecode=c3 length=20 units=km\nOpen Line.far 2"))
    assert found.network.switch.state == ("open",)
    assert found.network.admittance.name == ("line.far",)
    assert apart_pu(found) < 1e-8


STARS = {
    "constant power": "New Load.s bus1=n.1.2.3.4 kv=12.47 kw=300 kvar=90",
    "constant impedance, unbalanced": "New Load.s bus1=n.1.2.3.4 kv=12.47 kw=300 kvar=90 model=2\n"
    "New Load.one bus1=n.1 phases=1 kv=7.2 kw=200",
    "three loads": "".join(f"New Load.s{k} bus1=n.{k}.4 phases=1 kv=7.2 kw={90 + k} model=2\n" for k in (1, 2, 3)),
    "a capacitor and a load": "New Load.s bus1=n.1.2.3.4 kv=12.47 kw=300 kvar=90 model=2\n"
    "New Capacitor.c bus1=n bus2=n.4.4.4 kv=12.47 kvar=200",
    "generator": "New Generator.s bus1=n.1.2.3.4 kv=12.47 kw=300 kvar=90 model=2",
    "neutral reactor": "New Load.s bus1=n.1.2.3.4 kv=12.47 kw=300 kvar=90\nNew Reactor.g bus1=n.4 phases=1 r=20 x=1",
    "neutral conductor without ground": "New Line.four phases=4 bus1=n.1.2.3.4 bus2=y.1.2.3.4 length=0.2 units=km\n"
    "~ rmatrix=(0.4 | 0.1 0.4 | 0.1 0.1 0.4 | 0.1 0.1 0.1 0.6)\n"
    "~ xmatrix=(0.9 | 0.4 0.9 | 0.4 0.4 0.9 | 0.4 0.4 0.4 1.0)\n"
    "New Load.s bus1=y.1.2.3.4 kv=12.47 kw=300 kvar=90 model=2\nNew Load.t bus1=n.1.4 phases=1 kv=7.2 kw=90 model=2",
    "beyond a regulator": "New Transformer.r phases=3 buses=[n r] kvs=[12.47 12.47] kvas=[900 900] xhl=1\n"
    "New RegControl.r transformer=r winding=2 vreg=120 band=2 ptratio=60\n"
    "New Load.s bus1=r.1.2.3.4 kv=12.47 kw=300 kvar=90",
}


@pytest.mark.parametrize("case", STARS)
def test_a_star_whose_neutral_nothing_else_reaches_has_supply(case, master):
    found = read_circuit(master(STARS[case]))
    assert not [row for row in found.findings if row.fate in ("lost", "refused")]
    assert apart_pu(found) < 1e-6
    feeder = ThreePhaseFeeder.from_network(found.network)
    for share in (0.3, 1.0):
        solution = solve_unbalanced(feeder, share * feeder.p_load_kw, share * feeder.q_load_kvar)
        assert solution.converged


def test_a_floating_star_draws_its_power(master):
    circuit = "New Circuit.c bus1=a basekv=0.4\nNew Line.l bus1=a bus2=b r1=0.2 x1=0.1 r0=0.5 x0=0.3 c1=0 c0=0\n"
    star = "New Load.s bus1=b.1.2.3.4 kv=0.4 kw=9 kvar=3 vminpu=0.8\n"
    found = read_circuit(master(star, circuit, "Set VoltageBases=[0.4]\nCalcVoltageBases\n"))
    feeder = ThreePhaseFeeder.from_network(found.network)
    for share in (1.0, 0.4):
        solution = solve_unbalanced(feeder, share * feeder.p_load_kw, share * feeder.q_load_kvar)
        v = dict(zip(feeder.node_ids, solution.v_re_pu + 1j * solution.v_im_pu, strict=True))
        current = abs(v["a.a"] - v["b.a"]) * 400.0 / 3.0**0.5 / abs(0.2 + 0.1j)
        assert solution.loss_kw == pytest.approx(3.0 * 0.2 * current**2 / 1000.0, rel=1e-6)
        assert solution.source_p_kw - solution.loss_kw == pytest.approx(share * 9.0, rel=1e-6)


def test_a_dead_phase_of_a_load_is_not_supplied_through_its_ground(master):
    found = read_circuit(master("New Line.one bus1=n.1 bus2=p.1 phases=1 r1=1 x1=1\nNew Load.odd bus1=p kv=12.47 kw=9"),
                         allow=["isolated"])  # fmt: skip
    assert ("isolated", "load odd", "lost") in fates(found)


def test_a_bank_of_three_phases_at_two_nodes_has_the_voltages_of_opendss(master):
    bank = "New Transformer.bank phases=3 buses=[n.2.3 b.2.4] conns=[delta wye] kvs=[12.47 0.22] kvas=[75 75]\n"
    end = "\nSet VoltageBases=[12.47 0.22]\nCalcVoltageBases\n"
    found = read_circuit(master(f"{bank}New Load.b bus1=b.2.4 phases=1 kv=0.127 kw=10", end=end))
    assert apart_pu(found) < 1e-8
    [text] = [row.text for row in found.findings if (row.kind, row.fate) == ("transformer", "nothing lost")]
    assert "b.c with no node that has supply" in text


TIE = """New Line.tie bus1=n bus2=z r1={0} x1={1} r0={2} x0={0} c1=0 c0=0
New Line.back bus1=z bus2=m linecode=c3 length=1 units=km
New Load.z bus1=z kv=12.47 kw=900 kvar=300
New Load.z1 bus1=z.1 phases=1 kv=7.2 kw=200
"""


JUMPERS = {
    "line": "New Line.tie bus1=n bus2=z r1={0} x1={0} r0={0} x0={0} c1=0 c0=0",
    "switch": "New Line.tie bus1=n bus2=z switch=yes length=1 r1={0} x1={0} r0={0} x0={0} c1=0 c0=0",
    "reactor": "New Reactor.tie bus1=n bus2=z r={0} x={0}",
}


@pytest.mark.parametrize("kind", JUMPERS)
def test_jumpers_of_every_kind_are_compared_where_opendss_is_exact(kind, master):
    rest = "\n".join(TIE.splitlines()[1:])
    found = read_circuit(master(f"{JUMPERS[kind].format(1e-12)}\n{rest}"))
    assert apart_pu(found) < 1e-7
    assert any(row.names == ("tie",) and "its impedance is near 0" in row.text for row in found.findings)


@pytest.mark.parametrize("r_ohm", [1e-5, 1e-8, 1e-10, 1e-13])
def test_lines_of_nearly_no_impedance_are_exact(r_ohm, master):
    """OpenDSS itself is 9e-4 p.u. off at 1e-12 ohm; the right value is that of an impedance with which it is exact."""
    right = read_circuit(master(TIE.format(1e-7, 1e-8, 2e-7)))
    found = read_circuit(master(TIE.format(r_ohm, r_ohm / 10.0, 2.0 * r_ohm)))
    assert apart_pu(found) < 5e-8
    assert apart_pu(dataclasses.replace(found, v_pu=right.v_pu)) < 1e-7 + 0.1 * r_ohm
    feeder = ThreePhaseFeeder.from_network(found.network)
    solution = solve_unbalanced(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    assert solution.source_p_kw - solution.loss_kw == pytest.approx(1400.0, rel=1e-8)
