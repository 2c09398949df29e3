"""The control over time against OpenDSS's own regulator controls, in time mode with steps of a second."""

import numpy as np
import pytest

from dcgrid_env import load_feeder
from dcgrid_env.devices.tap_changer.relay import relay_settings, relay_volts
from dcgrid_env.devices.tap_changer.settling import settled_taps
from dcgrid_env.devices.tap_changer.tap_control import control_taps, initial_regulators
from dcgrid_env.powerflow import Control, solve_unbalanced

SECONDS = 90


def ours(feeder, tap, p_kw, q_kvar):
    """(second, regulator, tap) of each tap, and the taps at the end."""
    settings = relay_settings(feeder)

    def measured(taps):
        control = Control(feeder.tap_ratio(taps))
        return relay_volts(settings, solve_unbalanced(feeder, p_kw[None], q_kvar[None], control=control))

    state, moves = initial_regulators(tap, measured(tap)), []
    for second in range(1, SECONDS + 1):
        state = control_taps(settings, state, 1.0)
        moves += [(second, i, state.tap[0, i]) for i in np.flatnonzero(state.moved[0])]
        state = state._replace(relay_v=measured(state.tap))
    return moves, state.tap[0]


def opendss(feeder, tap, p_kw, q_kvar):
    from docs.studies.speed.opendss_circuit import OpenDss

    circuit, table = OpenDss(feeder), feeder.network.regulator
    text, names = circuit.dss.Text, [f"{n}_{p}" for n, p in zip(table.name, table.sensed_phase, strict=True)]
    for k, name in enumerate(names):
        text.Command = f"Edit Transformer.{name} wdg=2 maxtap=1.1 mintap=0.9 numtaps=32"
        text.Command = (
            f"New RegControl.{name} transformer={name} winding=2 vreg={table.vreg_v[k]} band={table.band_v[k]} "
            f"ptratio={table.pt_ratio[k]} ctprim={table.ct_primary_a[k]} R={table.r_ldc_v[k]} X={table.x_ldc_v[k]} "
            f"delay={table.delay_s[k]} tapdelay={table.tap_delay_s[k]}"
        )
    circuit.set_point(p_kw, q_kvar, feeder.v0_pu, feeder.tap_ratio(tap[0]), feeder.base_capacitor_on)
    text.Command = "Set mode=duty stepsize=1s number=1 time=(0,0) controlmode=time"
    last, moves = tap[0], []
    transformers, solution = circuit.dss.ActiveCircuit.Transformers, circuit.dss.ActiveCircuit.Solution
    for second in range(SECONDS + 1):  # its controls look for the first time at the end of its first step
        solution.Solve()
        now = []
        for name in names:
            transformers.Name = name
            transformers.Wdg = 2
            now.append(round((transformers.Tap - 1.0) / 0.00625))
        moves += [(second, i, now[i]) for i in np.flatnonzero(np.array(now) != last)]
        last = np.array(now)
    return moves, last


@pytest.mark.parametrize(
    ("name", "multiplier"), [("ieee13-3ph", 1.4), ("ieee13-3ph", 0.4), ("ieee34-3ph", 0.5), ("ieee34-3ph", 1.15)]
)
def test_the_same_taps_at_the_same_seconds_after_a_load_jump(name, multiplier):
    pytest.importorskip("dss", reason="OpenDSSDirect.py is not installed")
    feeder = load_feeder(name)
    tap = settled_taps(feeder, feeder.p_load_kw[None], feeder.q_load_kvar[None]).tap
    loads = (multiplier * feeder.p_load_kw, multiplier * feeder.q_load_kvar)
    (our_moves, our_end), (their_moves, their_end) = ours(feeder, tap, *loads), opendss(feeder, tap, *loads)
    assert len(our_moves) > 5
    assert our_moves == their_moves
    assert our_end.tolist() == their_end.tolist()
