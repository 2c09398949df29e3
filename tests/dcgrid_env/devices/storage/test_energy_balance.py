"""Energy of a storage is conserved: nothing comes from nowhere, and what is lost is counted."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from dcgrid_env import Storages
from dcgrid_env.devices.storage import energy_balance

SHARES = st.floats(0.0, 1.0, allow_subnormal=False)


def storages(**figures) -> Storages:
    return Storages(buses=("1",), **figures)


def course(params, asked_kw, dt_s, connected=None):
    """States before t = 0, at t = 0 and after each setpoint."""
    states = [energy_balance.initial(params, np.zeros((1, 1)))]
    for k, p_kw in enumerate([0.0, *asked_kw]):
        there = None if connected is None or k == 0 else np.full((1, 1), float(connected[k - 1]))
        states.append(energy_balance.step(params, states[-1], np.full((1, 1), p_kw), there, dt_s))
    return states


CASES = st.fixed_dictionaries(
    {
        "energy_kwh": st.floats(0.01, 100.0),
        "charge_efficiency": st.floats(0.3, 1.0),
        "discharge_efficiency": st.floats(0.3, 1.0),
        "standby_share_per_h": st.floats(0.0, 0.9, allow_subnormal=False),
        "initial_share": SHARES,
        "returned_share": st.floats(0.05, 1.0),
    }
)
ASKED = st.lists(st.floats(-100.0, 100.0), min_size=1, max_size=30)


@given(CASES, ASKED, st.sampled_from([0.1, 1.0, 60.0, 3600.0]))
def test_energy_is_that_of_before_with_what_went_in_and_out_and_what_stand_by_cost(figures, asked, dt_s):
    params, hours = storages(p_rated_kw=100.0, **figures).parameters, dt_s / 3600.0
    states = course(params, asked, dt_s)
    for before, after in pairwise(states):
        charge, discharge = max(after.storage_kw.item(), 0.0), max(-after.storage_kw.item(), 0.0)
        standby = before.stored_kwh.item() * (1.0 - (1.0 - figures["standby_share_per_h"]) ** hours)
        own = figures["charge_efficiency"] * charge - discharge / figures["discharge_efficiency"]
        assert after.stored_kwh.item() == pytest.approx(before.stored_kwh.item() + own * hours - standby, abs=1e-9)
        assert 0.0 <= after.stored_kwh.item() <= figures["energy_kwh"]
        assert abs(after.storage_kw.item()) <= 100.0
        assert 0.0 <= after.charge_limit_kw.item() <= 100.0
        assert 0.0 <= after.discharge_limit_kw.item() <= 100.0


@given(CASES, ASKED, st.sampled_from([0.1, 1.0, 60.0]))
def test_no_energy_is_free_at_the_end(figures, asked, dt_s):
    states = course(storages(p_rated_kw=100.0, **figures).parameters, asked, dt_s)
    first, last = states[0], states[-1]
    drawn = sum(state.storage_kw.item() for state in states) * dt_s / 3600.0
    lost = last.storage_loss_kwh.item()
    assert lost >= -1e-9
    assert drawn == pytest.approx(last.stored_kwh.item() - first.stored_kwh.item() + lost, abs=1e-9)
    returned = figures["returned_share"] * figures["initial_share"] * figures["energy_kwh"]
    assert last.missing_kwh.item() == pytest.approx(max(returned - last.stored_kwh.item(), 0.0), abs=1e-12)
    given_away = -drawn - (1.0 - figures["returned_share"]) * first.stored_kwh.item()
    assert last.missing_kwh.item() >= given_away - 1e-9  # more than what need not come back is missing


def test_full_and_empty_are_reached_and_not_passed():
    params = storages(p_rated_kw=60.0, energy_kwh=1.0, charge_efficiency=0.8, discharge_efficiency=0.5).parameters
    up, down = (course(params, [p_kw] * 3, 60.0) for p_kw in (60.0, -60.0))
    np.testing.assert_allclose([s.storage_kw.item() for s in up[2:]], [37.5, 0.0, 0.0], atol=1e-9)  # 0.5 kWh of room
    np.testing.assert_allclose([s.storage_kw.item() for s in down[2:]], [-15.0, 0.0, 0.0], atol=1e-9)
    assert (up[-1].stored_kwh.item(), down[-1].stored_kwh.item()) == pytest.approx((1.0, 0.0), abs=1e-12)


def test_what_is_disconnected_neither_charges_nor_discharges():
    params = storages(p_rated_kw=60.0, energy_kwh=10.0).parameters
    states = course(params, [60.0, 60.0, -60.0, -60.0], 60.0, connected=[1, 0, 0, 1])
    assert [s.storage_kw.item() for s in states[2:]] == [60.0, 0.0, 0.0, -60.0]


def test_tensors_give_what_arrays_give_and_a_derivative():
    params = storages(p_rated_kw=60.0, energy_kwh=1.0, standby_share_per_h=0.1).parameters
    asked = [20.0, -20.0, 10.0]
    last = course(params, asked, 60.0)[-1]
    tensors = type(params)(*(torch.tensor(figure) for figure in params))
    action = torch.tensor(asked, dtype=torch.float64, requires_grad=True)
    state = energy_balance.initial(tensors, torch.zeros((1, 1), dtype=torch.float64))
    for p_kw in (0.0 * action[0], *action):
        state = energy_balance.step(tensors, state, p_kw.reshape(1, 1), None, 60.0)
    np.testing.assert_allclose([part.item() for part in state], [part.item() for part in last], rtol=1e-12)
    (slope,) = torch.autograd.grad(state.stored_kwh.sum(), action)
    kept = 0.9 ** (1.0 / 60.0)
    np.testing.assert_allclose(slope, np.array([0.95 * kept**2, kept / 0.95, 0.95]) / 60.0, rtol=1e-9)
