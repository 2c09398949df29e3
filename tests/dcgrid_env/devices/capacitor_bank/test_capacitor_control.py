"""The control of capacitor banks: what is measured, thresholds, delay, steps of any length, tensors, settings."""

import numpy as np
import pytest
import torch

from dcgrid_env import load_feeder
from dcgrid_env.core.checked import FieldError
from dcgrid_env.devices.capacitor_bank.bank_measurements import bank_settings
from dcgrid_env.devices.capacitor_bank.bank_switching import (
    bank_delays,
    initial_banks,
    measured_banks,
    next_switchings,
)
from dcgrid_env.devices.capacitor_bank.capacitor_control import CapacitorControl
from dcgrid_env.devices.tap_changer.relay import settings_like
from dcgrid_env.powerflow import Control, solve_unbalanced
from helpers.feeders import THREE_PHASE

VOLTAGE = CapacitorControl(measures="voltage", on_below_pu=0.98, off_above_pu=1.04, delay_s=10.0)
KVAR = CapacitorControl(measures="kvar", on_above_share=0.5, off_below_share=-0.75, delay_s=10.0)


def settings_of(feeder, control):
    return bank_settings(feeder, control, [True] * feeder.n_capacitor)


def bank_at(on, value):
    """Two equal banks."""
    state = initial_banks(np.full((1, 2), float(on)))
    return state._replace(v_pu=np.full((1, 2), value), value=np.full((1, 2), value))


@pytest.mark.parametrize("name", THREE_PHASE)
def test_it_measures_the_power_that_flows_to_its_bus(name):
    feeder = load_feeder(name)
    table, on = feeder.network.capacitor, feeder.base_capacitor_on.copy()
    on[0] = 0.0
    control = Control(capacitor_on=on)
    solution = solve_unbalanced(feeder, feeder.p_load_kw[None], feeder.q_load_kvar[None], control=control)
    state = measured_banks(settings_of(feeder, KVAR), solution, initial_banks(on[None]))
    i = solution.i_re_a + 1j * solution.i_im_a
    v = (solution.v_re_pu + 1j * solution.v_im_pu) * feeder.base_kv_ln[feeder.node_bus]
    for row, bus in enumerate(table.bus):
        phases = "".join(p for p, kvar in zip("abc", table.kvar[row], strict=True) if kvar)
        nodes = list(feeder.nodes_of(bus, phases))
        assert state.v_pu[0, row] == pytest.approx(solution.v_pu[0, nodes].mean())
        into = (v * np.conj(i)).imag[0, nodes].sum()
        assert state.value[0, row] == pytest.approx(into / sum(table.kvar[row]))


def test_switching_a_bank_on_brings_the_measured_power_down_by_its_rating():
    feeder = load_feeder("ieee13-3ph")
    shares = []
    for on in (0.0, 1.0):
        states = np.array([[on, 1.0]])
        loads = feeder.p_load_kw[None], feeder.q_load_kvar[None]
        solution = solve_unbalanced(feeder, *loads, control=Control(capacitor_on=states))
        shares.append(measured_banks(settings_of(feeder, KVAR), solution, initial_banks(states)).value[0, 0])
    assert shares[0] - shares[1] == pytest.approx(1.0, abs=0.05)


def advanced(control, state, dt_s, controlled=None):
    """Banks after a step under constant measurements; switchings that are due at its end are made."""
    delay_s = bank_delays(settings_of(load_feeder("ieee13-3ph"), control), state, controlled)
    passed_s = 0.0 * state.on[..., :1] + dt_s
    return next_switchings(state._replace(switched=0.0 * state.switched), delay_s, passed_s, passed_s > 0.0)


@pytest.mark.parametrize(
    ("control", "state", "after"),
    [
        (VOLTAGE, bank_at(0, 0.979), 1),
        (VOLTAGE, bank_at(0, 0.981), 0),
        (VOLTAGE, bank_at(1, 1.041), 0),
        (VOLTAGE, bank_at(1, 0.9), 1),
        (KVAR, bank_at(0, 0.51), 1),
        (KVAR, bank_at(0, 0.49), 0),
        (KVAR, bank_at(1, -0.76), 0),
        (KVAR, bank_at(1, -0.74), 1),
    ],
)
@pytest.mark.parametrize("dt_s", [0.1, 1.0, 10.0, 3600.0])
def test_thresholds_and_delay_at_any_length_of_step(control, state, after, dt_s):
    before = state.on[0, 0]
    for step in range(1, 200):
        state = advanced(control, state, dt_s)
        if step * dt_s >= control.delay_s - 1e-9:
            break
        np.testing.assert_array_equal(state.on, before)
    np.testing.assert_array_equal(state.on, after)
    np.testing.assert_array_equal(state.switchings, abs(after - before))


def test_a_threshold_that_is_left_resets_the_clock_and_a_fixed_bank_stays():
    state = advanced(VOLTAGE, bank_at(0, 0.9), 9.0)
    state = advanced(VOLTAGE, state._replace(value=np.ones((1, 2))), 1.0)
    assert not state.beyond_s.any()
    state = advanced(VOLTAGE, state._replace(value=np.full((1, 2), 0.9)), 9.0)
    assert not state.on.any()
    np.testing.assert_array_equal(advanced(VOLTAGE, state, 1.0, np.array([1.0, 0.0])).on, [[1.0, 0.0]])


@pytest.mark.parametrize("control", [VOLTAGE, KVAR])
def test_tensors_have_the_same_bits(control):
    rng, settings = np.random.default_rng(0), settings_of(load_feeder("ieee13-3ph"), control)
    state = initial_banks(rng.integers(0, 2, (32, 2)).astype(float))
    state = state._replace(value=rng.normal(1.0, 0.05, (32, 2)) if control is VOLTAGE else rng.normal(size=(32, 2)))
    delay_s = bank_delays(settings, state)
    on_tensors = bank_delays(settings_like(settings, torch.zeros(0, dtype=torch.float64)), tensors(state))
    np.testing.assert_array_equal(on_tensors.numpy(), delay_s)
    passed_s, acts = np.full((32, 1), 10.0), np.full((32, 1), True)
    after = next_switchings(state, delay_s, passed_s, acts)
    on_tensors = next_switchings(tensors(state), on_tensors, torch.from_numpy(passed_s), torch.from_numpy(acts))
    assert 0.0 < after.switched.mean() < 1.0
    for tensor, array in zip(on_tensors, after, strict=True):
        np.testing.assert_array_equal(tensor.numpy(), array)


def tensors(state):
    return type(state)(*map(torch.from_numpy, state))


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
