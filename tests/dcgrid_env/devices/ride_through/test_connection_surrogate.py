"""The surrogate of trips and returns: values as without it, slopes that point where they should."""

from typing import Any

import numpy as np
import pytest
import torch

from dcgrid_env import TensorEnv, action_layout, make_scenario
from dcgrid_env.core.checked import FieldError
from dcgrid_env.devices.ride_through import connection
from dcgrid_env.devices.ride_through.connection import Supply
from dcgrid_env.devices.ride_through.connection_surrogate import TripWidths, smooth_step, smoothed_pace, softplus
from dcgrid_env.devices.ride_through.rules import UpsRideThrough
from helpers.riding import ride_through_34

RULE = UpsRideThrough(curve="itic", release="agent", walk_in_s=10.0)


def driven(widths):
    """Costs, shares on the grid, and the derivative of the sum of costs by a constant added to every action."""
    scenario = ride_through_34(horizon=60, split="train")
    env = TensorEnv(scenario, like=torch.empty(0), trip_widths=widths)
    env.reset(range(4))
    chance = torch.Generator().manual_seed(1)
    more = torch.zeros(action_layout(scenario).n, requires_grad=True)
    costs, shares, total = [], [], torch.zeros(())
    while not env.over:
        step = env.step(torch.rand(4, len(more), generator=chance) - 0.5 + more)
        costs.append(step.cost_j.detach())
        shares.append(step.state.devices[0].ups.share.detach())
        total = total + step.cost_j.mean()
    total.backward()
    assert more.grad is not None
    return torch.stack(costs), torch.stack(shares), more.grad


@pytest.mark.slow
def test_every_value_is_as_without_it_and_the_derivative_another():
    exact, smooth = driven(None), driven(TripWidths())
    assert torch.equal(exact[0], smooth[0])
    assert torch.equal(exact[1], smooth[1])
    assert (exact[1] < 1.0).any()
    assert torch.isfinite(smooth[2]).all()
    assert not torch.allclose(exact[2], smooth[2], rtol=0.01)


def after(v, share, rate: Any = 0.0, sags=None, wait_s=3.0, timer_s=0.0):
    """The state of one site after a step from a share, under a voltage, with a rate of return."""
    before = connection.initial(RULE, torch.zeros(1, 1))._replace(
        share=share, wait_s=torch.full((1, 1), wait_s), timer_s=torch.full((1, 1, 6), timer_s)
    )
    pace = torch.full((1, 1), rate) if not isinstance(rate, torch.Tensor) else rate
    return connection.advance(RULE, before, Supply(None, v, v, sags, TripWidths()), pace, 1.0)


def test_a_lower_voltage_is_nearer_to_a_slow_trip():
    v = torch.full((1, 1), 0.905, requires_grad=True)
    state = after(v, torch.ones(1, 1), timer_s=9.5)
    assert state.tripped.item() == 0.0
    assert torch.autograd.grad(state.tripped.sum(), v, retain_graph=True)[0].item() < 0.0
    assert torch.autograd.grad(state.share.sum(), v)[0].item() > 0.0


def test_who_is_away_does_not_trip_and_who_may_return_feels_the_channel():
    sag = torch.tensor([[[0.05, 0.3, 0.5]]])
    share = torch.full((1, 1), 0.4, requires_grad=True)
    state = after(torch.ones(1, 1), share, sags=sag)
    assert (state.tripped.item(), state.share.item()) == (1.0, 0.0)
    assert torch.autograd.grad(state.tripped.sum(), share)[0].item() == pytest.approx(1.0)

    for wait_s, slope in ((3.0, 1.0), (1.0, 0.0)):
        rate = torch.zeros(1, 1, requires_grad=True)
        state = after(torch.ones(1, 1), torch.zeros(1, 1), rate=rate, wait_s=wait_s)
        assert state.share.item() == 0.0
        assert torch.autograd.grad(state.share.sum() + 0.0 * rate.sum(), rate)[0].item() == pytest.approx(slope)


def test_smooth_steps_and_their_integral_stay_finite():
    x = torch.tensor([-100.0, -0.1, 0.0, 0.1, 100.0], dtype=torch.float64, requires_grad=True)
    step = smooth_step(x, 0.1)
    np.testing.assert_allclose(step.detach(), [0.0, 0.268941, 0.5, 0.731059, 1.0], atol=1e-6)
    slope = torch.autograd.grad(softplus(x, 0.1).sum(), x)[0]
    np.testing.assert_allclose(slope, step.detach(), atol=1e-9)


def test_bad_widths_and_arrays_without_derivatives():
    with pytest.raises(FieldError, match=r"v_pu is 0.0; give a finite number above 0"):
        TensorEnv("ride-through", like=torch.empty(0), trip_widths=TripWidths(v_pu=0.0))
    env = TensorEnv(make_scenario("ride-through", horizon=3), like=np.empty(0), trip_widths=TripWidths())
    env.reset([0])
    assert np.isfinite(env.step(np.zeros((1, 14))).cost_j).all()


@pytest.mark.parametrize("name", TripWidths._fields)
def test_range_and_defaults_of_the_widths(name):
    assert TripWidths() == (0.01, 1.0, 0.3)
    for width in (1e-9, 1e9):
        TripWidths(**{name: width}).check()
    for width in (0.9e-9, 1.1e9):
        with pytest.raises(FieldError, match=f"TripWidths: {name} is .*; give a finite number above 0"):
            TripWidths(**{name: width}).check()


def test_slopes_of_a_slow_trip_worked_by_hand():
    """Each of the 6 elements of ITIC has counted 9.5 s; the mildest, at 0.9 p.u., counts 10 s."""
    v = torch.full((1, 1), 0.905, dtype=torch.float64, requires_grad=True)
    timer_s = torch.zeros(1, 1, 6, dtype=torch.float64)
    timer_s[..., 0] = 9.5
    before = connection.initial(RULE, torch.zeros(1, 1, dtype=torch.float64))._replace(timer_s=timer_s)
    widths = TripWidths(v_pu=0.002, time_s=0.5)
    state = connection.advance(RULE, before, Supply(None, v, v.detach(), None, widths), 0.0, 1.0)
    near = 1.0 / (1.0 + np.exp(2.5))
    slope = -near * (1.0 - near) / 0.002
    late = 1.0 / (1.0 + np.exp(-1.0))
    timer = torch.autograd.grad(state.timer_s[..., 0].sum(), v, retain_graph=True)[0].item()
    assert timer == pytest.approx(10.5 * slope)
    assert torch.autograd.grad(state.tripped.sum(), v)[0].item() == pytest.approx(late * slope, rel=1e-6)


def test_the_slope_of_a_return_by_its_rate():
    rate = torch.tensor([[-0.03, 0.0, 0.06]], dtype=torch.float64, requires_grad=True)
    pace = smoothed_pace(torch.clip(rate, 0.0) * 2.0, rate, 0.1, 2.0, TripWidths(rate_share=0.3))
    np.testing.assert_allclose(pace.detach(), [[0.0, 0.0, 0.12]])
    slope = torch.autograd.grad(pace.sum(), rate)[0]
    np.testing.assert_allclose(slope, [[2.0 / (1.0 + np.e), 1.0, 2.0 / (1.0 + np.exp(-2.0))]])
    far = softplus(torch.tensor([4.0, 0.0, -4.0], dtype=torch.float64), 0.1)
    np.testing.assert_allclose(far, [4.0, 0.1 * np.log(2.0), 0.0], atol=1e-12)
