"""Monotone networks: their slope stays within its bound whatever the weights, and they are saved like any other."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env import make_scenario
from dcgrid_env.agents import Network, Policy, PolicyError
from dcgrid_env.agents.policy.monotone import UNITS, WIDTH, Head, MonotoneNetwork, head_output
from dcgrid_env.agents.training.torch_modules import Monotone
from dcgrid_env.baselines import rollout

DEVIATIONS = np.linspace(-4.0, 4.0, 401)


def context(n_in, seed=0, scale=1.0):
    rng = np.random.default_rng(seed)
    return Network([(rng.normal(0.0, scale, (n_in, WIDTH)), rng.normal(0.0, scale, WIDTH))], squash="none")


def head(columns, slope=0.7, offset=False, seed=0, scale=1.0):
    widths = np.random.default_rng(seed).uniform(0.05, 2.0, UNITS).astype(np.float32)
    return Head(context(len(columns), seed, scale), np.array(columns), widths, slope, offset)


weights = st.lists(st.floats(-40.0, 40.0), min_size=WIDTH, max_size=WIDTH)


@settings(max_examples=60)
@given(figures=weights, widths=st.lists(st.floats(1e-3, 10.0), min_size=UNITS, max_size=UNITS), offset=st.booleans())
def test_the_slope_is_between_0_and_the_bound_whatever_the_context_says(figures, widths, offset):
    given_context = np.broadcast_to(np.array(figures), (len(DEVIATIONS), WIDTH))
    out = head_output(DEVIATIONS, given_context, np.array(widths), 0.7, offset)
    slope = np.diff(out) / np.diff(DEVIATIONS)
    assert np.isfinite(out).all()
    assert slope.max() <= 1e-9
    assert slope.min() >= -0.7 - 1e-9


@settings(max_examples=15)
@given(seed=st.integers(0, 10_000), scale=st.floats(0.01, 30.0))
def test_the_slope_of_a_network_of_any_weights(seed, scale):
    network = MonotoneNetwork([head([1, 2], 0.7, False, seed, scale), head([2], 3.0, True, seed + 1, scale)], 3)
    seen = np.random.default_rng(seed).normal(0.0, 2.0, (50, 1, 3)).astype(np.float32)
    seen = np.repeat(seen, len(DEVIATIONS), axis=1)
    seen[..., 0] = DEVIATIONS
    slope = np.diff(network(seen), axis=1) / np.diff(DEVIATIONS)[:, None]
    assert slope.max() <= 1e-3  # float32, differences of 0.02
    assert (slope.min((0, 1)) >= np.array([-0.7, -3.0]) - 1e-2).all()


def test_a_head_by_hand():
    figures = np.zeros(WIDTH)
    figures[0], figures[UNITS + 1] = np.log(2.0), np.log(5.0)  # shares 2 : 1 (six times) : 5 of 13
    figures[UNITS + 2], figures[UNITS + 3] = 0.5, -0.25  # where the straight and the first bent unit are 0
    figures[-1] = 0.1
    z, widths = 0.4, np.arange(1.0, UNITS + 1.0)
    bent = sum(t * np.tanh((z + 0.25 * (t == 1.0)) / t) for t in widths)
    psi = (2.0 * (z - 0.5) + bent) / 13.0
    assert head_output(np.array(z), figures, widths, 0.6, False) == pytest.approx(-0.6 * psi, rel=1e-12)
    assert head_output(np.array(z), figures, widths, 0.6, True) == pytest.approx(0.1 - 0.6 * psi, rel=1e-12)
    tensor = head_output(torch.tensor(z, dtype=torch.float64), torch.tensor(figures), torch.tensor(widths), 0.6, True)
    assert float(tensor) == pytest.approx(0.1 - 0.6 * psi, rel=1e-12)


@pytest.mark.parametrize("share", [0.3, 0.7, 0.999])
def test_the_function_that_keeps_the_loop_stable_falls_at_every_step(share):
    """q' = q - S psi(X q + w) under lambda_max(S^1/2 X S^1/2) < 2: the sum of s_i times the integral of psi_i falls."""
    rng = np.random.default_rng(3)
    for _ in range(10):
        half = rng.normal(size=(4, 4))
        x, s = half @ half.T, rng.uniform(0.1, 1.0, 4)
        s *= share * 2.0 / np.linalg.eigvalsh(np.sqrt(s)[:, None] * x * np.sqrt(s))[-1]
        contexts, widths = rng.normal(0.0, 1.0, (4, WIDTH)), rng.uniform(0.5, 2.0, (4, UNITS))
        contexts[:, 0] += 3.0  # mostly straight, so that the slope is close to its bound
        shares = np.exp(contexts[:, : UNITS + 2])
        shares /= shares.sum(1, keepdims=True)
        centres, w, q = contexts[:, UNITS + 2 : -1], 3.0 * rng.normal(size=4), np.zeros(4)
        potential = []
        for _ in range(60):
            z = x @ q + w
            apart = z[:, None] - centres
            bent = widths**2 * np.log(np.cosh(apart[:, 1:] / widths))
            potential.append(s @ (0.5 * shares[:, 0] * apart[:, 0] ** 2 + (shares[:, 1:-1] * bent).sum(1)))
            q = q + np.array([head_output(z[i], contexts[i], widths[i], s[i], False) for i in range(4)])
        assert potential[-1] < potential[0]
        assert np.diff(potential).max() < 1e-12


def test_other_figures_are_seen_by_the_heads_that_may():
    network = MonotoneNetwork([head([1]), head([2], offset=True)], 4)
    base = network(np.zeros(4, np.float32))
    for column, moves in ((1, [True, False]), (2, [False, True]), (3, [False, False])):
        seen = np.zeros(4, np.float32)
        seen[column] = 1.0
        assert (network(seen) != base).tolist() == moves


def test_a_policy_of_monotone_networks_is_saved_and_read_again(tmp_path):
    torch.manual_seed(1)
    made = Monotone(torch.zeros(12), torch.ones(12), [[5, 7], [6]], [1.5, 0.25], [True, False], (8,)).exported()
    other = Monotone(torch.zeros(10), torch.ones(10), [[5, 6]], [0.25], [False], (8,)).exported()
    policy = Policy({"datacenter": made, "inverter": other}, nameplate=True, outputs="change", scenario="toy6")
    found = Policy.load(policy.save(tmp_path / "safe"))
    assert found.sha256 == policy.sha256
    network = found.networks["datacenter"]
    assert isinstance(network, MonotoneNetwork)
    assert [(h.slope, h.offset, h.columns.tolist()) for h in network.heads] == [(1.5, True, [5, 7]), (0.25, False, [6])]
    seen = np.random.default_rng(0).normal(size=(5, 12)).astype(np.float32)
    np.testing.assert_array_equal(network(seen), made(seen))
    scenario = make_scenario("toy6", horizon=5)
    one, again = ([m["J"] for m in rollout(scenario, p, range(2)).metrics()] for p in (policy, found))
    assert one == again


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: MonotoneNetwork([], 3), "heads is empty"),
        (lambda: MonotoneNetwork([head([1, 3])], 3), r"head 0: columns are \[1, 3\]; give some of 0 .. 2 without 0"),
        (lambda: MonotoneNetwork([head([1]), head([0, 1])], 3), r"head 1: columns are \[0, 1\]; give some"),
        (lambda: MonotoneNetwork([head([-1])], 3), r"columns are \[-1\]"),
        (lambda: MonotoneNetwork([head([1], slope=0.0)], 3), "head 0: give 6 widths and a slope above 0"),
        (lambda: MonotoneNetwork([head([1], slope=np.nan)], 3), "head 0: give 6 widths and a slope above 0"),
        (lambda: MonotoneNetwork([head([1])._replace(widths=np.zeros(UNITS))], 3), "give 6 widths"),
        (lambda: MonotoneNetwork([head([1])._replace(widths=np.ones(2))], 3), "give 6 widths"),
        (lambda: MonotoneNetwork([head([1])._replace(context=context(2))], 3), "takes 2 figures and gives 16"),
    ],
)  # fmt: skip
def test_heads_that_do_not_fit_are_named(make, message):
    with pytest.raises(PolicyError, match=message):
        make()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a, s: a.pop("widths0"), "widths0"),
        (lambda a, s: a.update(columns0=np.array([9.0])), "columns are"),
        (lambda a, s: s["heads"][0].update(slope=-1.0), "slope above 0"),
        (lambda a, s: a["context0.w0"].__setitem__((0, 0), np.nan), "w0 holds nan"),
    ],
)
def test_arrays_that_are_none_of_a_network(change, message):
    network = MonotoneNetwork([head([1])], 3)
    arrays, about = {name: array.copy() for name, array in network.arrays().items()}, network.settings()
    change(arrays, about)
    with pytest.raises((PolicyError, KeyError), match=message):
        MonotoneNetwork.read(arrays, about)
