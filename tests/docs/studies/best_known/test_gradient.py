"""The gradient by windows that are stepped side by side is that of the whole episode."""

import numpy as np
import pytest
import torch

from dcgrid_env import TensorEnv, action_layout, make_scenario
from docs.studies.best_known import gradient
from docs.studies.best_known.driving import driven


@pytest.mark.parametrize(("preset", "horizon"), [("smoothing", 70), ("ride-through", 50)])
@pytest.mark.slow
def test_windows_have_the_gradient_of_whole_episodes(monkeypatch, preset, horizon):
    monkeypatch.setattr(gradient, "WINDOW", 20)
    s, seeds = make_scenario(preset, split="test", horizon=horizon), [2, 0]
    env = TensorEnv(s, like=torch.empty(0, dtype=torch.float64))
    actions = np.random.default_rng(0).uniform(-0.6, 0.6, (horizon, 2, action_layout(s).n))
    env.reset(seeds)
    taken = torch.tensor(actions, requires_grad=True)
    total = torch.stack([env.step(action).cost_j.sum() for action in taken]).sum()
    (whole,) = torch.autograd.grad(total, taken)

    by_windows = gradient.CostGradient(s, seeds)
    assert len(by_windows.starts) == -(-horizon // 20)
    j, states = driven(s, seeds, actions, by_windows.starts)
    assert j.sum() * horizon == pytest.approx(float(total.detach()), rel=1e-6)
    by_windows.settle(actions, states)
    assert by_windows(actions, states) == pytest.approx(whole.numpy(), rel=1e-3, abs=1e-4 * float(whole.abs().max()))
