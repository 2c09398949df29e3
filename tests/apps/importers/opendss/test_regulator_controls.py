"""RegControls that sense another bus or compensate by magnitudes tap in the seconds in which OpenDSS's do."""

from dataclasses import replace

import numpy as np
import pytest

from dcgrid_env import FeederError, ThreePhaseFeeder
from dcgrid_env.apps.importers.opendss.reading import read_circuit
from dcgrid_env.devices.tap_changer.regulator_state import initial_regulators
from dcgrid_env.devices.tap_changer.relay import RelayBand, relay_settings, relay_volts
from dcgrid_env.devices.tap_changer.timed_taps import next_taps
from dcgrid_env.powerflow import Control, solve_unbalanced
from helpers.opendss_imports import by_opendss, fates

pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")

CIRCUIT = """
New Transformer.reg phases=1 buses=[m.2 r.2] kvs=[7.2 7.2] kvas=[2000 2000] xhl=0.01 %loadloss=0.001
New Line.j bus1=m.1.3 bus2=r.1.3 phases=2 switch=yes
New Line.l3 bus1=r bus2=e length=5 units=km r1=0.3 x1=0.4 r0=0.5 x0=1.2 c1=30 c0=15
New Load.e bus1=e kv=12.47 kw=3000 kvar=1500 model=2 vminpu=0.5 vmaxpu=1.5
"""
AT = "transformer=reg winding=2 band=1.6 ptratio=60 ctprim=300 delay=5 tapdelay=2"
CASES = {
    "own winding": "vreg=124",
    "R and X": "vreg=122 R=3 X=2",
    "magnitudes": "vreg=118 ldc_z=4 R=7",
    "another bus": "vreg=118 bus=e.2 remoteptratio=60",
}


def tap(engine):
    engine.RegControls.Name("k")
    return engine.RegControls.TapNumber()


def ours(feeder, factors):
    settings = relay_settings(feeder)
    band = RelayBand(settings.target_v[None], settings.half_band_v[None])
    state, found = initial_regulators(feeder.base_tap[None], np.zeros((1, 1))), []
    for factor in factors:
        left_s = np.ones((1, 1))
        while left_s[0, 0] > 0.0:
            loads, control = (factor * feeder.p_load_kw[None], factor * feeder.q_load_kvar[None]), state.tap
            solution = solve_unbalanced(feeder, *loads, control=Control(feeder.tap_ratio(control)))
            state = state._replace(relay_v=relay_volts(settings, solution))
            state, passed_s = next_taps(settings, state, band, left_s, np.full((1, 1), np.inf), False)
            left_s = left_s - passed_s
        found.append(state.tap[0, 0])
    return np.array(found)


@pytest.mark.parametrize("case", CASES)
def test_taps_are_made_when_opendss_makes_them(master, tmp_path, case):
    path = master(f"{CIRCUIT}New RegControl.k {AT} {CASES[case]}\n")
    feeder = ThreePhaseFeeder.from_network(read_circuit(path).network)
    factors = 0.7 + 0.3 * np.sin(np.arange(600) / 80.0)
    opendss_has = by_opendss(path, factors, tap)
    assert np.abs(np.diff(opendss_has)).sum() >= 4
    np.testing.assert_array_equal(ours(feeder, factors), opendss_has)
    feeder.to_csv(folder := tmp_path / "tables")
    assert repr(ThreePhaseFeeder.from_csv(folder).network) == repr(feeder.network)


@pytest.mark.parametrize(
    ("column", "message"),
    [
        ({"sensed_bus": ("nowhere",)}, "sensed_bus is 'nowhere'; no such bus"),
        ({"sensed_bus": ("e",), "x_ldc_v": (1.0,)}, "with sensed_bus all are 0"),
        ({"z_ldc_v": (1.0,), "r_ldc_v": (1.0,)}, "with z_ldc_v the others are 0"),
        ({"z_ldc_v": (-1.0,)}, "z_ldc_v is -1.0"),
        ({"sensed_bus": ("r",), "sensed_phase": ("a",)}, "sensed_phase is 'a'; its phases are b"),
    ],
)
@pytest.mark.slow
def test_relays_that_cannot_be(master, column, message):
    network = read_circuit(master(f"{CIRCUIT}New RegControl.k {AT} vreg=121\n")).network
    with pytest.raises(FeederError, match=message):
        ThreePhaseFeeder.from_network(replace(network, regulator=replace(network.regulator, **column)))


def test_a_bus_without_supply_is_named(master):
    with pytest.raises(FeederError, match=r"it senses its own terminal here, as e\.9 is no phase with supply"):
        read_circuit(master(f"{CIRCUIT}New RegControl.k {AT} vreg=121 bus=e.9\n"))


def test_a_reversible_control_is_the_same_while_power_flows_forward(master):
    found = read_circuit(master(f"{CIRCUIT}New RegControl.k {AT} vreg=121 reversible=yes revneutral=yes\n"))
    assert ("regcontrol", "k", "nothing lost") in fates(found)
