"""Controlled capacitor banks against OpenDSS's CapControl, in time mode with steps of a second."""

import numpy as np
import pytest

from dcgrid_env import load_feeder, make_scenario
from dcgrid_env.engine.physics import equipment as feeder_equipment
from dcgrid_env.engine.physics.dynamics import solve_rows_of

pytest.importorskip("dss", reason="OpenDSSDirect.py is not installed")

SECONDS = 900
BANKS = {"ieee13-3ph": ("cap2", 0.98, 1.0), "ieee123-3ph": ("c92c", 0.995, 1.0)}
"""A bank of one phase of each feeder, and its thresholds of voltage, p.u., which are passed with the taps fixed."""


def jumping_loads(feeder, row, seed):
    """Loads of each second, kW and kvar, (SECONDS + 1, n_leg): jumps of all, and of the reactive load at the bank."""
    rng = np.random.default_rng(seed)
    jumps = np.flatnonzero(rng.random(SECONDS + 1) < 0.04)
    part = np.searchsorted(jumps, np.arange(SECONDS + 1), side="right")
    share = rng.uniform(0.3, 1.4, len(jumps) + 1)[part, None]
    p_kw, q_kvar = share * feeder.p_load_kw, share * feeder.q_load_kvar
    table, legs = feeder.network.capacitor, feeder.load_legs
    at_bus = np.flatnonzero(np.array([feeder.bus_ids[b] for b in legs.bus]) == table.bus[row])
    q_kvar[:, at_bus] = rng.choice([0.1, 0.4, 1.6], len(jumps) + 1)[part, None] * sum(table.kvar[row])
    return p_kw, q_kvar


def ours(name, bank, settings, p_kw, q_kvar):
    """(second, on) of each switching of the bank."""
    scenario = make_scenario(
        name,
        **{
            "grid_control.capacitors": {bank: "controlled"},
            "grid_control.regulators": "fixed",
            "grid_control.capacitor_settings": settings,
            "grid_control.regulator_settings": {"timer": "reset"},
        },
    )
    row, out = scenario.feeder.network.capacitor.name.index(bank), []
    solve = solve_rows_of(scenario, None, p_kw[:1], q_kvar[:1], None)
    equipment = feeder_equipment.initial_equipment(scenario, p_kw[:1], q_kvar[:1], None, None, None)
    equipment = feeder_equipment.measured(scenario, equipment, solve(equipment, slice(None), None))
    for second in range(1, SECONDS + 1):
        solve = solve_rows_of(scenario, None, p_kw[second : second + 1], q_kvar[second : second + 1], None)
        before, equipment = equipment.banks.on[0, row], feeder_equipment.advanced(scenario, equipment, ())
        solution = solve(equipment, slice(None), None)
        equipment, _ = feeder_equipment.with_controls(scenario, equipment, (), None, solution, solve)
        if equipment.banks.on[0, row] != before:
            out.append((second, int(equipment.banks.on[0, row])))
    return out


def opendss(name, bank, settings, p_kw, q_kvar):
    from docs.studies.speed.opendss_circuit import OpenDss

    feeder = load_feeder(name)
    circuit, table, legs = OpenDss(feeder), feeder.network.capacitor, feeder.capacitor_legs
    row = table.name.index(bank)
    leg = int(np.flatnonzero(legs.row == row)[0])
    volts = 1e3 * feeder.base_kv_ln[legs.bus[leg]]
    line = feeder.network.phase_line
    branch = line.name[line.to_bus.index(table.bus[row])]
    kvar = float(sum(table.kvar[row]))
    if settings["measures"] == "voltage":
        on, off = settings["on_below_pu"] * volts, settings["off_above_pu"] * volts
        rule = f"type=voltage element=Capacitor.leg{leg} terminal=1 PTratio=1 ONsetting={on} OFFsetting={off}"
    else:
        rule = f"type=kvar element=Line.{branch} terminal=1 ONsetting={0.5 * kvar} OFFsetting={-0.75 * kvar}"
    text, delay = circuit.dss.Text, settings["delay_s"]
    state, out = feeder.base_capacitor_on.copy(), []
    circuit.set_point(p_kw[0], q_kvar[0], feeder.v0_pu, feeder.tap_ratio(feeder.base_tap), state)
    text.Command = (
        f"New CapControl.c capacitor=leg{leg} {rule} delay={delay} delayoff={delay} deadtime=0 voltoverride=no"
    )
    text.Command = "Set mode=duty stepsize=1s number=1 time=(0,0) controlmode=time"
    for second in range(1, SECONDS + 1):
        circuit.set_point(p_kw[second], q_kvar[second], feeder.v0_pu, feeder.tap_ratio(feeder.base_tap), state)
        circuit.dss.ActiveCircuit.Solution.Solve()
        circuit.dss.ActiveCircuit.Capacitors.Name = f"leg{leg}"
        now = float(circuit.dss.ActiveCircuit.Capacitors.States[0])
        if now != state[row]:
            out.append((second, int(now)))
        state[row] = now
    return out


@pytest.mark.parametrize("measures", ["voltage", "kvar"])
@pytest.mark.parametrize("name", BANKS)
@pytest.mark.slow
def test_the_same_switchings_at_the_same_seconds(name, measures):
    bank, on_below_pu, off_above_pu = BANKS[name]
    feeder = load_feeder(name)
    row = feeder.network.capacitor.name.index(bank)
    settings = {"measures": measures, "delay_s": 12.0, "on_below_pu": on_below_pu, "off_above_pu": off_above_pu}
    seen = 0
    for seed in range(3):
        loads = jumping_loads(feeder, row, seed)
        theirs = opendss(name, bank, settings, *loads)
        assert ours(name, bank, settings, *loads) == theirs
        seen += len(theirs)
    assert seen > 10
