"""A RegControl that does not act in OpenDSS moves no tap in an episode either, whatever the scenario's mode."""

import numpy as np
import pytest

from dcgrid_env import ScenarioError, ThreePhaseFeeder, read_feeder, scenario_on
from dcgrid_env.apps.importers.opendss.reading import read_circuit
from dcgrid_env.baselines import NoControl, rollout
from helpers.opendss_imports import apart_pu, fates

pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")

CIRCUIT = """
Clear
New Circuit.two basekv=12.47 pu=1.01 bus1=s MVAsc3=2000 MVAsc1=2000
New Transformer.ra phases=3 buses=[s a] kvs=[12.47 12.47] kvas=[9000 9000] xhl=0.01 %loadloss=0.001
New Transformer.rb phases=3 buses=[s b] kvs=[12.47 12.47] kvas=[9000 9000] xhl=0.01 %loadloss=0.001 wdg=2 tap=1.0125
New RegControl.ca transformer=ra winding=2 vreg=123 band=2 ptratio=60
New RegControl.cb transformer=rb winding=2 vreg=127 band=2 ptratio=60
New Line.la bus1=a bus2=a2 length=2 units=km r1=0.3 x1=0.6 r0=0.5 x0=1.2 c1=0 c0=0
New Line.lb bus1=b bus2=b2 length=2 units=km r1=0.3 x1=0.6 r0=0.5 x0=1.2 c1=0 c0=0
New Load.a bus1=a2 kv=12.47 kw=3000 pf=0.95
New Load.b bus1=b2 kv=12.47 kw=3000 pf=0.95
"""
FIXED = {
    "enabled": ("Edit RegControl.cb enabled=no", "cb"),
    "batch": ("BatchEdit RegControl..* enabled=no", "ca cb"),
    "disable": ("Disable RegControl.cb", "cb"),
    "no taps per move": ("Edit RegControl.cb maxtapchange=0", "cb"),
    "all controls off": ("Set ControlMode=off", "ca cb"),
    "off in a solution": ("Solve controlmode=off", "ca cb"),
}


def taps_of_opendss(path):
    """Taps by regulator after OpenDSS solves the script with the controls that it leaves."""
    from opendssdirect import dss

    engine = dss.NewContext()
    engine.Text.Command(f'redirect "{path}"')
    engine.Solution.Solve()
    found = {}
    for name in engine.RegControls.AllNames():
        engine.RegControls.Name(name)
        found[name] = engine.RegControls.TapNumber()
    return found


def first_taps(feeder, **changes):
    scenario = scenario_on(feeder, "1 x 1 kW at a2", "none").replace(
        horizon=120, background={"load_sigma": 0.0}, **changes
    )
    taps = rollout(scenario, NoControl(), [0]).series(0).three_phase.equipment.regulators.tap
    return dict(zip(feeder.network.regulator.name, taps[0].tolist(), strict=True)), taps


@pytest.mark.slow
@pytest.mark.parametrize("how", FIXED)
def test_taps_are_those_of_opendss(master, how):
    command, fixed = FIXED[how]
    path = master(f"{command}\n", CIRCUIT, "Set VoltageBases=[12.47]\nCalcVoltageBases\n")
    found = read_circuit(path)
    assert apart_pu(found) < 1e-6
    feeder = ThreePhaseFeeder.from_network(found.network)
    expected = taps_of_opendss(path)
    if fixed == "cb":
        assert expected["ca"] > 0
    first, taps = first_taps(feeder)
    for name, tap in expected.items():
        held = name in fixed.split()
        assert first[name] == (tap if held else pytest.approx(tap, abs=1.0))  # OpenDSS moves several taps at once
        assert ((name, "nothing lost") in {(n, fate) for kind, n, fate in fates(found) if kind == "regcontrol"}) == held
    names = list(feeder.network.regulator.name)
    for name in fixed.split():
        assert (taps[:, names.index(name)] == expected[name]).all()


def test_a_fixed_tap_between_two_steps_is_a_transformer_at_its_ratio(master):
    more = "Edit Transformer.rb wdg=2 tap=1.0031\nEdit RegControl.cb enabled=no vlimit=130 cogen=yes\n"
    found = read_circuit(master(more, CIRCUIT, "Set VoltageBases=[12.47]\nCalcVoltageBases\n"))
    assert apart_pu(found) < 1e-6
    assert found.network.regulator.name == ("ca",)
    assert "rb" in found.network.transformer.name
    assert not [row for row in found.findings if row.fate in ("lost", "refused")]


def test_the_control_that_acts_is_taken_where_another_of_its_transformer_is_disabled(master):
    more = "New RegControl.first transformer=ra winding=2 vreg=118 band=2 ptratio=60 enabled=no\n"
    found = read_circuit(master(more, CIRCUIT, "Set VoltageBases=[12.47]\nCalcVoltageBases\n"))
    table = found.network.regulator
    assert dict(zip(table.name, table.vreg_v, strict=True)) == {"ca": 123.0, "cb": 127.0}
    assert np.all(np.array(table.max_taps_per_move) > 0)


BANK = """
New Capacitor.k bus1=b2 kv=12.47 kvar=900
New CapControl.kc capacitor=k element=line.lb terminal=2 type=voltage onsetting=130 offsetting=131 ptratio=60 delay=15
Edit Capacitor.k states=[0]
"""
IDLE = {
    "disabled": "Disable CapControl.kc",
    "by its property": "CapControl.kc.enabled=no",
    "all controls off": "Set ControlMode=off",
}


@pytest.mark.slow
@pytest.mark.parametrize("how", IDLE)
def test_a_bank_whose_control_does_not_act_stays_in_its_state(master, tmp_path, how):
    path = master(f"{BANK}{IDLE[how]}\n", CIRCUIT, "Set VoltageBases=[12.47]\nCalcVoltageBases\n")
    found = read_circuit(path)
    assert apart_pu(found) < 1e-6
    assert not len(found.network.capacitor_control)
    assert ("capcontrol", "kc", "nothing lost") in fates(found)
    ThreePhaseFeeder.from_network(found.network).to_csv(tmp_path / "folder")
    feeder = read_feeder(tmp_path / "folder")
    with pytest.raises(ScenarioError, match=r"the states of k are fixed in feeder 'two'; leave it out, or give is_f"):
        scenario_on(feeder, "1 x 1 kW at a2", "none").replace(grid_control={"capacitors": "controlled"})
    assert bank_on(feeder) == {0.0}


@pytest.mark.slow
def test_a_bank_with_a_control_that_acts_switches_on_where_it_is_controlled(master):
    found = read_circuit(master(BANK, CIRCUIT, "Set VoltageBases=[12.47]\nCalcVoltageBases\n"))
    assert bank_on(ThreePhaseFeeder.from_network(found.network), "controlled") == {0.0, 1.0}


def bank_on(feeder, mode="fixed"):
    scenario = scenario_on(feeder, "1 x 1 kW at a2", "none").replace(
        horizon=60, background={"load_sigma": 0.0}, grid_control={"capacitors": mode}
    )
    return set(rollout(scenario, NoControl(), [0]).series(0).three_phase.equipment.banks.on.ravel().tolist())


@pytest.mark.parametrize("taps", ["numtaps=0", "mintap=1 maxtap=1"])
def test_a_winding_of_one_tap_is_a_transformer(master, taps):
    more = f"Edit Transformer.rb wdg=2 tap=1.0 {taps}\n"
    found = read_circuit(master(more, CIRCUIT, "Set VoltageBases=[12.47]\nCalcVoltageBases\n"))
    assert apart_pu(found) < 1e-6
    assert found.network.regulator.name == ("ca",)
    assert ("regcontrol", "cb", "nothing lost") in fates(found)


def test_the_control_of_a_disabled_transformer_is_no_loss(master):
    more = "Disable Transformer.rb\nNew Line.by bus1=s bus2=b length=0.01 units=km r1=0.1 x1=0.1 r0=0.1 x0=0.1\n"
    found = read_circuit(master(more, CIRCUIT, "Set VoltageBases=[12.47]\nCalcVoltageBases\n"))
    assert apart_pu(found) < 1e-6
    assert ("regcontrol", "cb", "nothing lost") in fates(found)
