"""The interior-point method against HiGHS, and on a program that has no solution."""

import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import linprog

from dcgrid_env.baselines.model_based.interior_point import Rows, minimise

STEPS, N, K = 12, 15, 3


def program(seed):
    """Random deviations of known price, |x| at most 0.3, and a price on what x moves from step to step."""
    rng, n_x = np.random.default_rng(seed), STEPS * K
    dense, at, price = rng.normal(size=(STEPS, N, K)), rng.normal(size=(STEPS, N)), rng.uniform(0.5, 1.0, (STEPS, N))
    one = sparse.identity(n_x, format="csr")
    moved = one - sparse.eye(n_x, k=-K, format="csr")
    rows = Rows(dense, one, (1.0, -1.0), sparse.vstack([one, -one, moved, -moved], format="csr"), 2 * K - 1)
    h = np.concatenate([price.ravel(), price.ravel(), np.full(2 * n_x, np.inf), np.full(2 * n_x, 3.0)])
    k = np.concatenate([-at.ravel(), at.ravel(), np.full(2 * n_x, 0.3), np.zeros(2 * n_x)])
    return rows, h, k


def by_simplex(rows, h, k):
    n_x = rows.quantities.shape[1]
    matrix = np.array([rows.apply(unit) for unit in np.eye(n_x)]).T
    soft = np.isfinite(h)
    over = -np.eye(len(h))[:, soft]
    prices = np.concatenate((np.zeros(n_x), h[soft]))
    bounds = [(None, None)] * n_x + [(0.0, None)] * int(soft.sum())
    return linprog(prices, A_ub=np.hstack((matrix, over)), b_ub=k, bounds=bounds).fun


@pytest.mark.parametrize("seed", range(3))
def test_it_finds_the_optimum_of_the_simplex_method(seed):
    rows, h, k = program(seed)
    found = minimise(np.zeros(STEPS * K), rows, h, k, np.zeros(STEPS * K), constant=7.0)
    assert found.value == pytest.approx(7.0 + by_simplex(rows, h, k), rel=2e-6)
    assert found.bound == pytest.approx(found.value, rel=1e-6)
    assert np.abs(found.x).max() <= 0.3 + 1e-6
    assert found.steps < 30


def test_transposed_and_normal_are_those_of_apply():
    rows, h, _ = program(3)
    matrix = np.array([rows.apply(unit) for unit in np.eye(STEPS * K)]).T
    weights = np.random.default_rng(1).uniform(0.1, 2.0, len(h))
    np.testing.assert_allclose(rows.transposed(weights), matrix.T @ weights, atol=1e-12)
    right = np.arange(STEPS * K, dtype=float)
    solved = rows.normal(weights)(right)
    np.testing.assert_allclose(matrix.T @ (weights * (matrix @ solved)), right, atol=1e-8)


def test_constraints_that_exclude_each_other_are_no_optimum():
    rows, h, k = program(0)
    k[np.flatnonzero(np.isinf(h))] = -0.1  # x <= -0.1 and x >= 0.1
    with pytest.raises(ArithmeticError, match="the constraints may exclude each other"):
        minimise(np.zeros(STEPS * K), rows, h, k, np.zeros(STEPS * K))
