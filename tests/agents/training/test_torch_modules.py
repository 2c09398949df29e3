"""Networks in training become networks of arrays that do the same; the clip that lets a step back through."""

import numpy as np
import pytest
import torch

from dcgrid_env.agents.training.torch_modules import CLIP, HistoryPerceptron, Monotone, Perceptron, forgiving_clip


def moments(n, seed=0):
    rng = np.random.default_rng(seed)
    return torch.tensor(rng.normal(size=n), dtype=torch.float32), torch.tensor(
        rng.uniform(0.1, 2.0, n), dtype=torch.float32
    )


def shaken(module, seed=0):
    """The module with random weights, those of its beginning being small."""
    torch.manual_seed(seed)
    with torch.no_grad():
        for weight in module.parameters():
            weight.add_(0.3 * torch.randn_like(weight))
    return module


def made(which, seed=0):
    torch.manual_seed(seed)
    if which == "perceptron":
        return shaken(Perceptron(*moments(6), 3, (16, 8)), seed)
    return shaken(Monotone(*moments(6), [[1, 3], [2, 4, 5]], [0.7, 2.0], [True, False], (8,)), seed)


@pytest.mark.parametrize("which", ["perceptron", "monotone"])
@pytest.mark.parametrize("shape", [(6,), (5, 6), (4, 2, 6)])
def test_what_is_exported_does_the_same(which, shape):
    module = made(which)
    seen = np.random.default_rng(1).normal(0.0, 2.0, shape).astype(np.float32)
    seen[..., 0] *= 20.0  # beyond what is clipped
    expected = module(torch.tensor(seen)).detach().numpy()
    network = module.exported()
    assert (network.n_in, network.n_out) == (6, expected.shape[-1])
    assert network(seen).dtype == np.float32
    np.testing.assert_allclose(network(seen), expected, rtol=1e-5, atol=1e-5)
    assert np.abs(expected).max() > 0.1


def test_what_is_exported_stands_still_while_training_goes_on():
    module, seen = made("monotone"), np.ones((2, 6), np.float32)
    network = module.exported()
    before = network(seen)
    shaken(module, 5)
    np.testing.assert_array_equal(network(seen), before)
    assert not np.allclose(module.exported()(seen), before)


@pytest.mark.parametrize("shape", [(4,), (5, 4), (3, 2, 4)])
def test_what_is_exported_remembers_the_same(shape):
    torch.manual_seed(0)
    module = shaken(HistoryPerceptron(*moments(4 + 2 * 3), 2, (8,), [0, 3], 3))
    network, rng = module.exported(), np.random.default_rng(1)
    assert (network.n_in, network.n_out) == (4, 2)
    memory = kept = None
    for step in range(5):
        seen = rng.normal(size=shape).astype(np.float32)
        expected, kept = module.advance(torch.tensor(seen), kept)
        found, memory = network.advance(seen, memory)
        np.testing.assert_allclose(found, expected.detach().numpy(), rtol=1e-5, atol=1e-5)
        assert (np.abs(found - network(seen)).max() > 0.01) == (step > 0)


def test_a_history_begins_close_to_a_network_without():
    torch.manual_seed(0)
    module = HistoryPerceptron(torch.zeros(10), torch.ones(10), 2, (64, 64), [0, 1], 3)
    first, memory = module.advance(torch.randn(100, 4), None)
    wide = torch.cat((torch.zeros(100, 4), torch.randn(100, 6)), -1)
    assert float(module.network(wide).detach().abs().max()) < 0.1
    assert float(first.detach().abs().max()) < 0.5
    assert [tuple(a.shape) for a in memory] == [(100, 2)] * 3


def test_observations_are_normalised_and_clipped():
    mean, std = torch.tensor([1.0, 2.0]), torch.tensor([0.5, 4.0])
    module = Perceptron(mean, std, 1, ())
    with torch.no_grad():
        module.layers[0].weight.copy_(torch.tensor([[1.0, 10.0]]))  # pyright: ignore
        module.skip.copy_(torch.tensor([[0.0], [100.0]]))
    # (2 - 1) / 0.5 = 2 and (6 - 2) / 4 = 1; a thousand of either is CLIP
    found = module(torch.tensor([[2.0, 6.0], [1e3, -1e3]])).detach()
    assert float(found[0]) == pytest.approx(2.0 + 10.0 + 100.0)
    assert float(found[1]) == pytest.approx(CLIP - 110.0 * CLIP)


def test_it_begins_close_to_an_output_of_0():
    torch.manual_seed(0)
    module = Perceptron(*moments(9), 2, (64, 64))
    assert float(module(3.0 * torch.randn(100, 9)).detach().abs().max()) < 0.5


def test_the_forgiving_clip_by_hand():
    # A weight below 0 asks for more, above 0 for less. Beyond a limit what asks for still further is dropped.
    x = torch.tensor([-2.0, -2.0, -1.0, 0.3, 0.3, 1.0, 2.0, 2.0, 2.0], requires_grad=True)
    weight = torch.tensor([1.0, -3.0, 1.0, 1.0, -1.0, -1.0, -1.0, 5.0, 0.0])
    cut = forgiving_clip(x, -1.0, 1.0)
    assert cut.tolist() == pytest.approx([-1.0, -1.0, -1.0, 0.3, 0.3, 1.0, 1.0, 1.0, 1.0])
    (slope,) = torch.autograd.grad(cut, x, weight)
    assert slope.tolist() == [0.0, -3.0, 1.0, 1.0, -1.0, -1.0, 0.0, 5.0, 0.0]


def test_descent_comes_back_from_beyond_the_limits_and_goes_no_further_out():
    back = torch.tensor([5.0, -5.0, 5.0], requires_grad=True)
    aim = torch.tensor([0.5, -0.5, 2.0])
    for _ in range(200):
        (slope,) = torch.autograd.grad(((forgiving_clip(back, -1.0, 1.0) - aim) ** 2).sum(), back)
        back = (back - 0.1 * slope).detach().requires_grad_()
    assert back.tolist() == pytest.approx([0.5, -0.5, 5.0], abs=1e-3)
