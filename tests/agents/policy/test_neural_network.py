"""Networks of NumPy arrays: the forward pass, what is refused, and the way into arrays and back."""

import itertools

import numpy as np
import pytest

from dcgrid_env.agents import Network, PolicyError


def network(*widths, **settings):
    rng = np.random.default_rng(0)
    pairs = itertools.pairwise(widths)
    return Network([(rng.normal(size=(n_in, n_out)), rng.normal(size=n_out)) for n_in, n_out in pairs], **settings)


def test_a_forward_pass_worked_by_hand():
    layers = [([[1.0, -2.0], [0.5, 0.25]], [0.5, 0.0]), ([[2.0], [-1.0]], [0.1])]
    seen = np.array([3.0, 2.0])
    # (3 - 1) / 2 = 1, (2 - 0) / 0.5 = 4 cut to 3; layer: 1 + 1.5 + 0.5 = 3, -2 + 0.75 = -1.25; relu: 3, 0; 6 + 0.1.
    known = {"mean": [1.0, 0.0], "std": [2.0, 0.5], "clip": 3.0}
    assert Network(layers, "relu", "clip", **known)(seen) == [1.0]
    assert Network(layers, "relu", "tanh", **known)(seen) == pytest.approx([np.tanh(6.1)])
    assert Network(layers, "relu", "clip", **known, scale=[0.25])(seen) == [0.25]  # after the squash
    cut = known | {"clip": [[-3.0, 0.5], [-1.0, 3.0]]}  # the first input is -1 instead of 1
    assert Network(layers, "relu", "none", **cut)(seen) == pytest.approx([2.0 * 1.0 - 2.75 + 0.1])
    small = [(np.array(w) / 10.0, np.array(b) / 10.0) for w, b in layers]
    # 0.3, -0.125 before the activation; out is 0.2 f(0.3) - 0.1 f(-0.125) + 0.01.
    for name, f in {
        "tanh": np.tanh,
        "relu": lambda x: max(x, 0.0),
        "elu": lambda x: x if x > 0 else np.exp(x) - 1.0,
        "silu": lambda x: x / (1.0 + np.exp(-x)),
    }.items():
        expected = 0.2 * f(0.3) - 0.1 * f(-0.125) + 0.01
        assert Network(small, name, **known)(seen) == pytest.approx([expected], rel=1e-6)


def test_activations_of_large_figures_are_finite():
    for name in ("tanh", "relu", "elu", "silu"):
        with np.errstate(over="raise", invalid="raise"):
            out = Network([([[1.0]], [0.0]), ([[1e-30]], [0.0])], name)(np.array([[1e5], [-1e5]]))
        assert np.isfinite(out).all()


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"activation": "silu", "squash": "tanh", "clip": 5.0, "std": [0.5] * 3},
        {"clip": np.array([[-1.0] * 3, [0.5] * 3]), "scale": np.array([0.5, 2.0])},
    ],
)
def test_arrays_and_settings_make_the_same_network(settings):
    one = network(3, 8, 2, **settings)
    assert set(one.arrays()) == {"w0", "b0", "w1", "b1", *(name for name, value in settings.items() if np.ndim(value))}
    two = Network.read(one.arrays(), one.settings())
    seen = np.random.default_rng(1).normal(size=(4, 3))
    np.testing.assert_array_equal(one(seen), two(seen))
    assert (two.n_in, two.n_out) == (3, 2)
    with pytest.raises(KeyError, match="w1"):
        Network.read({name: array for name, array in one.arrays().items() if name != "w1"}, one.settings())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Network([]), "layers is empty"),
        (lambda: network(3, 2, activation="sigmoid"), "activation is 'sigmoid'; choose one of tanh, relu, elu, silu"),
        (lambda: network(3, 2, squash="sign"), "squash is 'sign'; choose one of clip, tanh, none"),
        (lambda: network(3, 2, clip=0.0), "clip is 0.0; give a number above 0"),
        (lambda: network(3, 2, clip=[[1.0] * 3]), r"clip has shape \(1, 3\); it must be \(2, 3\)"),
        (lambda: network(3, 2, scale=[1.0]), r"scale has shape \(1,\); it must be \(2,\)"),
        (lambda: Network([(np.ones((3, 2)), np.ones(3))]), r"w0 has shape \(3, 2\); with 3 inputs and b0"),
        (lambda: Network([(np.ones((3, 2)), np.ones(2)), (np.ones((3, 1)), [0.0])]), r"w1 has shape \(3, 1\)"),
        (lambda: Network([(np.ones(3), np.ones(3))]), r"w0 has shape \(3,\); give 2 dimensions"),
        (lambda: Network([([[np.nan]], [0.0])]), r"w0 holds nan; give finite numbers"),
        (lambda: Network([([["a"]], [0.0])]), "w0 is no array of real numbers; give float32"),
        (lambda: Network([([[1j]], [0.0])]), "w0 is no array of real numbers; give float32"),
        (lambda: Network([([[1e300]], [0.0])]), "w0 holds inf; give finite numbers"),
        (lambda: network(3, 2, mean=[0.0, 0.0]), r"mean has shape \(2,\); give one figure for each of 3 inputs"),
        (lambda: network(3, 2, std=[1.0, 0.0, 1.0]), "std is 0.0 somewhere; give figures above 0"),
    ],
)  # fmt: skip
def test_what_cannot_be_a_network_is_named(make, message):
    with pytest.raises(PolicyError, match=message):
        make()
