"""Regulators and capacitor banks as agents: their actions, speed and observations."""

import numpy as np
import pytest
import torch

from dcgrid_env import load_feeder
from dcgrid_env.core.arrays import rounded
from dcgrid_env.devices import Device
from dcgrid_env.devices.capacitor_bank.capacitor_banks import CapacitorBanks
from dcgrid_env.devices.tap_changer.tap_changers import TapChangers

FEEDER = load_feeder("ieee13-3ph")
TAPS = TapChangers.of_feeder(FEEDER, (0, 2))
BANKS = CapacitorBanks.of_feeder(FEEDER, (0, 1))


def moved_to(asked, dt_s, steps):
    """Tap of the first regulator after each step, from the base tap 10."""
    state, zero = TAPS.initial(TAPS.parameters, np.zeros((1, 2))), np.zeros((1, 2))
    taps = []
    for _ in range(steps):
        state, drawn = TAPS.step(TAPS.parameters, state, (zero + asked,), None, dt_s)
        assert (drawn == 0.0).all()
        taps.append(state.tap[0, 0])
    return taps


@pytest.mark.parametrize(
    ("asked", "dt_s", "taps"),
    [
        (12.4, 1.0, [11, 12, 12, 12]),
        (16.0, 1.0, [11, 12, 12, 13, 13, 14]),
        (16.0, 0.5, [11, 11, 11, 12, 12, 12, 12, 13]),
        (-16.0, 10.0, [4, -1, -6, -11, -16, -16]),
        (-16.0, 3600.0, [-16, -16]),
        (10.4, 1.0, [10, 10]),
    ],
)
def test_the_drive_makes_a_tap_in_two_seconds(asked, dt_s, taps):
    assert moved_to(asked, dt_s, len(taps)) == taps


def test_a_bank_is_switched_at_once():
    state = BANKS.initial(BANKS.parameters, np.zeros((1, 2)))
    assert state.on.tolist() == [[1.0, 1.0]]
    state, drawn = BANKS.step(BANKS.parameters, state, (np.array([[0.49, 0.51]]),), None, 1.0)
    assert (state.on.tolist(), state.switched.tolist()) == ([[0.0, 1.0]], [[1.0, 0.0]])
    assert state.since_s.tolist() == [[0.0, 1.0]]
    assert (drawn == 0.0).all()


@pytest.mark.parametrize("device", [TAPS, BANKS], ids=["taps", "banks"])
def test_they_are_devices_without_power(device):
    assert device.count == len(device.buses) == len(device.phases) == 2
    assert (device.q_limit_kvar == 0.0).all()
    assert device.cost_terms(10, 1.0) == ()
    assert len(device.fields(10, 1.0)) == len(
        device.observe(device.parameters, device.initial(device.parameters, 0.0), None)
    )
    (channel,) = device.channels
    assert (channel.rest == device.parameters.base).all()
    with pytest.raises(KeyError, match="moved"):
        device.amount("moved", device.parameters, None)
    assert isinstance(device, Device)


def test_rounding_has_the_derivative_of_what_is_rounded():
    values = np.linspace(-16.0, 16.0, 1001)
    tensor = torch.tensor(values, requires_grad=True)
    np.testing.assert_array_equal(rounded(tensor).detach().numpy(), np.rint(values))
    np.testing.assert_array_equal(rounded(values), np.rint(values))
    (2.0 * rounded(tensor)).sum().backward()
    assert tensor.grad is not None
    assert (tensor.grad == 2.0).all()
