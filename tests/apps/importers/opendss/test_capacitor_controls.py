"""CapControls: what they become, and that their banks switch in the seconds in which OpenDSS switches them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from dcgrid_env import FeederError, ThreePhaseFeeder
from dcgrid_env.apps.importers.opendss.reading import read_circuit
from dcgrid_env.devices.capacitor_bank.bank_measurements import bank_settings
from dcgrid_env.devices.capacitor_bank.bank_switching import (
    bank_delays,
    initial_banks,
    measured_banks,
    next_switchings,
)
from dcgrid_env.devices.capacitor_bank.capacitor_control import CapacitorControl
from dcgrid_env.powerflow import Control, solve_unbalanced
from helpers.opendss_imports import apart_pu, by_opendss

pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")

CIRCUIT = """
New Line.l3 bus1=m bus2=e length=6 units=km r1=0.3 x1=0.4 r0=0.5 x0=1.2 c1=300 c0=150
New Load.e bus1=e kv=12.47 kw=2400 kvar=1500 model=2 vminpu=0.5 vmaxpu=1.5
New Load.eb bus1=e.2 phases=1 kv=7.2 kw=300 kvar=500 model=2 vminpu=0.5 vmaxpu=1.5
"""
BANK = "New Capacitor.c bus1=m kv=12.47 kvar=900\n"
SINGLE = "New Capacitor.c bus1=m.2 phases=1 kv=7.2 kvar=600\n"
STEPS = "New Capacitor.c bus1=m kv=12.47 numsteps=3 kvar=[300 300 300] states=[1 0 0]\n"
DELTA = "New Capacitor.c bus1=m kv=12.47 kvar=900 conn=delta\n"
AT = "capacitor=c element=line.l3 delay=4 delayoff=7 deadtime=20"
CASES = {
    "voltage": (BANK, "type=voltage onsetting=120 offsetting=121.5 ptratio=60 ptphase=2"),
    "mean voltage": (BANK, "type=voltage onsetting=117 offsetting=120 ptratio=60 ptphase=avg terminal=2"),
    "highest voltage": (BANK, "type=voltage onsetting=121.3 offsetting=122.3 ptratio=60 ptphase=max"),
    "voltage of a delta": (DELTA, "type=voltage onsetting=210 offsetting=212 ptratio=60 ptphase=3"),
    "kvar": (BANK, "type=kvar onsetting=1500 offsetting=900"),
    "kvar at the far end": (BANK, "type=kvar onsetting=-900 offsetting=-1500 terminal=2"),
    "kvar of one phase": (SINGLE, "type=kvar onsetting=1500 offsetting=900"),
    "kvar or voltage": (BANK, "type=kvar onsetting=1900 offsetting=1000 voltoverride=yes vmin=117 vmax=120 ptratio=60"),
    "current": (BANK, "type=current onsetting=2 offsetting=1.6 ctratio=60 ctphase=2"),
    "least current": (BANK, "type=current onsetting=1.5 offsetting=1.2 ctratio=60 ctphase=min"),
    "power factor": (BANK, "type=pf onsetting=0.84 offsetting=0.88"),
    "power factor of enough": (BANK, "type=pf onsetting=0.85 offsetting=0.88 pctminkvar=140"),
    "steps": (STEPS, "type=voltage onsetting=121 offsetting=122.3 ptratio=60 delay=2 delayoff=3"),
}  # fmt: skip


def courses(n=900, hold_s=10):
    """Factors of the loads by the second.

    They stay for the delays of all steps: OpenDSS does not reset the delay of a bank of several steps between its
    thresholds.
    """
    rng, factor, found = np.random.default_rng(3), 0.5, []
    for second in range(n):
        if second % hold_s == 0:
            factor = rng.uniform(0.1, 1.3)
        found.append(factor)
    return np.array(found)


def states(engine):
    """Whether each step of the bank is on."""
    engine.Capacitors.Name("c")
    steps = engine.Capacitors.States()
    engine.Circuit.SetActiveElement("capacitor.c")
    is_open = engine.CktElement.IsOpen(1, 0)
    return [0.0 if is_open else float(step) for step in steps]


def ours(feeder, factors):
    """The same from the control of the banks."""
    settings = bank_settings(feeder, CapacitorControl(), [True] * feeder.n_capacitor)
    state, found = initial_banks(feeder.base_capacitor_on[None]), []
    for factor in factors:
        left_s = np.ones((1, 1))
        while left_s[0, 0] > 0.0:
            loads = factor * feeder.p_load_kw[None], factor * feeder.q_load_kvar[None]
            solution = solve_unbalanced(feeder, *loads, control=Control(capacitor_on=state.on))
            state = measured_banks(settings, solution, state)
            delay_s = bank_delays(settings, state)
            acts = delay_s.min(-1, keepdims=True) < left_s - 1e-6
            passed_s = np.where(acts, delay_s.min(-1, keepdims=True), left_s)
            state = next_switchings(state, delay_s, passed_s, acts)
            left_s = left_s - passed_s
        found.append(state.on[0])
    return np.array(found)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.slow
def test_banks_switch_when_those_of_opendss_do(master, tmp_path, case):
    bank, control = CASES[case]
    path = master(f"{CIRCUIT}{bank}New CapControl.k {AT} {control}\n")
    imported = read_circuit(path)
    feeder, factors = ThreePhaseFeeder.from_network(imported.network), courses()
    opendss_has = by_opendss(path, factors, states)
    assert np.abs(np.diff(opendss_has, axis=0)).sum() >= 7
    np.testing.assert_array_equal(ours(feeder, factors), opendss_has)
    feeder.to_csv(folder := tmp_path / "tables")
    assert repr(ThreePhaseFeeder.from_csv(folder).network) == repr(feeder.network)


LOST = {
    "type=time onsetting=6 offsetting=20": "type=Time is not among",
    "type=kvar onsetting=1 offsetting=2": "OnSetting=1 and OffSetting=2 would switch it back and forth",
    "type=current ctphase=3 element=load.eb": "it measures current at Load.eb, which has 1 ends",
    "type=voltage onsetting=117 offsetting=120 ptphase=2 element=load.eb": "its phases of no number at e are not",
    "type=kvar onsetting=2 offsetting=1 element=transformer.t": "at the end that feeds it, and that is no line",
}


@pytest.mark.parametrize("control", LOST)
def test_a_control_that_cannot_be_represented_is_named(master, control):
    more = "New Transformer.t buses=[m x] kvs=[12.47 0.48] kvas=[50 50]\nNew Capacitor.other bus1=n kv=12.47 kvar=90\n"
    path = master(f"{CIRCUIT}{more}{BANK}New CapControl.k {AT} {control}\n")
    with pytest.raises(FeederError, match=LOST[control]):
        read_circuit(path)
    imported = read_circuit(path, allow=["capcontrol"])
    assert not len(imported.network.capacitor_control)


@pytest.mark.slow
def test_a_bank_that_its_control_has_opened_is_off_and_can_be_switched(master):
    off = "New Capacitor.c bus1=m kv=12.47 kvar=900 states=[0]\n"
    control = f"New CapControl.k {AT} type=kvar\n"
    for bank, state in (
        (off + control, "off"),
        (BANK + control, "on"),
        (f"{BANK}{control}Open Capacitor.c 1\n", "off"),
    ):
        imported = read_circuit(master(f"{CIRCUIT}{bank}"))
        assert imported.network.capacitor.state == (state,)
        assert imported.network.capacitor_control.capacitor == ("c",)
        assert apart_pu(imported) < 1e-8


def test_two_controls_of_one_bank_leave_the_first(master):
    path = master(f"{CIRCUIT}{BANK}New CapControl.k {AT} type=kvar\nNew CapControl.l {AT} type=kvar\n")
    imported = read_circuit(path, allow=["capcontrol"])
    assert imported.network.capacitor_control.name == ("k",)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("capacitor", "x", "capacitor is 'x'; there are c"),
        ("measures", "hour", "measures is 'hour'; choose voltage, current, kvar, power_factor"),
        ("legs", "a d", "legs is 'a d'; give phases or pairs of phases of bus m, which has abc"),
        ("legs_of", "sum", "legs_of is 'sum'; choose mean, max, min"),
        ("from_bus", "n", "give the ends of a line or switch of phase a"),
        ("to_bus", "z", "to_bus is 'z'; give a bus with the phases abc"),
        ("on_at", 800.0, "on_at is 800.0; for kvar it must be more than off_at, 900"),
        ("pt_ratio", 0.0, "pt_ratio"),
        ("delay_on_s", math.nan, "delay_on_s"),
        ("after", "c", "after is 'c'; give another of c, or leave it empty"),
    ],
)
def test_tables_that_cannot_be(master, field, value, message):
    network = read_circuit(master(f"{CIRCUIT}{BANK}New CapControl.k {AT} {CASES['kvar'][1]}\n")).network
    assert network.capacitor_control.name == ("k",)
    changed = replace(network.capacitor_control, **{field: (value,)})
    with pytest.raises(FeederError, match=message):
        ThreePhaseFeeder.from_network(replace(network, capacitor_control=changed))
