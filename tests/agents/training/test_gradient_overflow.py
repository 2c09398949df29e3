"""Derivatives that grow from step to step are limited to finite values, and others are unchanged."""

import math

import pytest

torch = pytest.importorskip("torch")

from dcgrid_env.agents.training.torch_modules import LARGEST, without_overflow  # noqa: E402


def gain_after(steps: int, factor: float, bounded: bool):
    """A loop of a policy of one weight and a plant that multiplies, over so many steps; the weight's derivative."""
    weight = torch.tensor(1.0, requires_grad=True)
    x = torch.full((2, 1), 1e-6)
    for _ in range(steps):
        action = weight * x
        x = factor * (without_overflow(action) if bounded else action)
        x = x.detach() * 0.0 + 1e-6 + (x - x.detach())  # the plant's limits hold x, and not its derivative
    x.sum().backward()
    assert weight.grad is not None
    return float(weight.grad)


def test_an_unstable_loop_has_a_finite_derivative():
    assert not math.isfinite(gain_after(100, 10.0, bounded=False))
    found = gain_after(100, 10.0, bounded=True)
    assert math.isfinite(found)
    assert found > 0.0


def test_a_derivative_within_the_bound_is_the_same_to_the_bit():
    for factor in (0.9, 1.1, 1.3):
        assert gain_after(40, factor, bounded=True) == gain_after(40, factor, bounded=False)


def test_each_episode_is_scaled_by_itself():
    actions = torch.zeros(2, 3, requires_grad=True)
    given = torch.tensor([[1e12, -5e11, 0.0], [1.0, -2.0, 3.0]])
    (without_overflow(actions * 1.0) * given).sum().backward()
    assert actions.grad is not None
    assert actions.grad[0].tolist() == pytest.approx([LARGEST, -0.5 * LARGEST, 0.0])
    assert (actions.grad[1] == given[1]).all()
