"""The control of capacitor banks: what is measured, thresholds, delay, steps of any length, tensors, settings."""

import numpy as np
import pytest
import torch

from dcgrid_env import load_feeder
from dcgrid_env.core.checked import FieldError
from dcgrid_env.devices.capacitor_bank.capacitor_control import (
    CapacitorControl,
    bank_delays,
    bank_settings,
    initial_banks,
    measured_banks,
    next_switchings,
)
from dcgrid_env.powerflow import Control, solve_unbalanced
from helpers.feeders import THREE_PHASE

VOLTAGE = CapacitorControl(measures="voltage", on_below_pu=0.98, off_above_pu=1.04, delay_s=10.0)
KVAR = CapacitorControl(measures="kvar", on_above_share=0.5, off_below_share=-0.75, delay_s=10.0)


def bank_at(on, v_pu=1.0, kvar_share=0.0):
    state = initial_banks(np.array([[float(on)]]))
    return state._replace(v_pu=np.array([[v_pu]]), kvar_share=np.array([[kvar_share]]))


@pytest.mark.parametrize("name", THREE_PHASE)
def test_it_measures_the_power_that_flows_to_its_bus(name):
    feeder = load_feeder(name)
    table, on = feeder.network.capacitor, feeder.base_capacitor_on.copy()
    on[0] = 0.0
    control = Control(capacitor_on=on)
    solution = solve_unbalanced(feeder, feeder.p_load_kw[None], feeder.q_load_kvar[None], control=control)
    state = measured_banks(bank_settings(feeder), solution, initial_banks(on[None]))
    i = solution.i_re_a + 1j * solution.i_im_a
    v = (solution.v_re_pu + 1j * solution.v_im_pu) * feeder.base_kv_ln[feeder.node_bus]
    for row, bus in enumerate(table.bus):
        phases = "".join(p for p, kvar in zip("abc", table.kvar[row], strict=True) if kvar)
        nodes = list(feeder.nodes_of(bus, phases))
        assert state.v_pu[0, row] == pytest.approx(solution.v_pu[0, nodes].mean())
        into = (v * np.conj(i)).imag[0, nodes].sum()
        assert state.kvar_share[0, row] == pytest.approx(into / sum(table.kvar[row]))


def test_switching_a_bank_on_brings_the_measured_power_down_by_its_rating():
    feeder = load_feeder("ieee13-3ph")
    shares = []
    for on in (0.0, 1.0):
        states = np.array([[on, 1.0]])
        loads = feeder.p_load_kw[None], feeder.q_load_kvar[None]
        solution = solve_unbalanced(feeder, *loads, control=Control(capacitor_on=states))
        shares.append(measured_banks(bank_settings(feeder), solution, initial_banks(states)).kvar_share[0, 0])
    assert shares[0] - shares[1] == pytest.approx(1.0, abs=0.05)


def advanced(control, state, dt_s, controlled=None):
    """Banks after a step under constant measurements; switchings that are due at its end are made."""
    delay_s = bank_delays(control, state, controlled)
    passed_s = 0.0 * state.on[..., :1] + dt_s
    return next_switchings(state._replace(switched=0.0 * state.switched), delay_s, passed_s, passed_s > 0.0)


@pytest.mark.parametrize(
    ("control", "state", "after"),
    [
        (VOLTAGE, bank_at(0, v_pu=0.979), 1),
        (VOLTAGE, bank_at(0, v_pu=0.981), 0),
        (VOLTAGE, bank_at(1, v_pu=1.041), 0),
        (VOLTAGE, bank_at(1, v_pu=0.9), 1),
        (KVAR, bank_at(0, kvar_share=0.51), 1),
        (KVAR, bank_at(0, kvar_share=0.49), 0),
        (KVAR, bank_at(1, kvar_share=-0.76), 0),
        (KVAR, bank_at(1, kvar_share=-0.74), 1),
    ],
)
@pytest.mark.parametrize("dt_s", [0.1, 1.0, 10.0, 3600.0])
def test_thresholds_and_delay_at_any_length_of_step(control, state, after, dt_s):
    before = state.on.item()
    for step in range(1, 200):
        state = advanced(control, state, dt_s)
        if step * dt_s >= control.delay_s - 1e-9:
            break
        assert state.on.item() == before
    assert state.on.item() == after
    assert state.switchings.item() == abs(after - before)


def test_a_threshold_that_is_left_resets_the_clock_and_a_fixed_bank_stays():
    state = advanced(VOLTAGE, bank_at(0, v_pu=0.9), 9.0)
    state = advanced(VOLTAGE, state._replace(v_pu=np.array([[1.0]])), 1.0)
    assert state.beyond_s.item() == 0.0
    state = advanced(VOLTAGE, state._replace(v_pu=np.array([[0.9]])), 9.0)
    assert state.on.item() == 0.0
    assert advanced(VOLTAGE, state, 1.0).on.item() == 1.0
    assert advanced(VOLTAGE, state, 1.0, np.array([0.0])).on.item() == 0.0


@pytest.mark.parametrize("control", [VOLTAGE, KVAR])
def test_tensors_have_the_same_bits(control):
    rng = np.random.default_rng(0)
    state = initial_banks(rng.integers(0, 2, (32, 3)).astype(float))
    state = state._replace(v_pu=rng.normal(1.0, 0.05, (32, 3)), kvar_share=rng.normal(0.0, 1.0, (32, 3)))
    after = advanced(control, state, 60.0)
    on_tensors = advanced(control, type(state)(*map(torch.from_numpy, state)), 60.0)
    assert 0.0 < after.switched.mean() < 1.0
    for tensor, array in zip(on_tensors, after, strict=True):
        np.testing.assert_array_equal(tensor.numpy(), array)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"measures": "current"}, "measures is 'current'"),
        ({"on_below_pu": 1.04, "off_above_pu": 1.0}, "off_above_pu is 1.0; give more than"),
        ({"off_below_share": -0.4}, "or it never rests"),
        ({"delay_s": -1.0}, "delay_s is -1.0"),
    ],
)
def test_settings_that_cannot_be(fields, message):
    with pytest.raises(FieldError, match=message):
        CapacitorControl(**fields)
