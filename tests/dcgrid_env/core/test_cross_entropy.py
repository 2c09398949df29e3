import numpy as np
import pytest

from dcgrid_env.core.cross_entropy import CrossEntropy


def searched(cost, n, iterations, seed=0, population=64, elites=10):
    """The distribution after a search from zero."""
    distribution = CrossEntropy(np.zeros(n), 1.0, 0.1, elites)
    for i in range(1, iterations + 1):
        candidates = distribution.candidates(np.random.default_rng([seed, i]), population)
        distribution.update(candidates, cost(candidates), i / iterations)
    return distribution


@pytest.mark.parametrize("seed", range(3))
def test_the_minimum_of_a_quadratic_is_found(seed):
    optimum, scale = np.linspace(-1.5, 2.0, 10), np.logspace(0.0, 1.0, 10)
    found = searched(lambda x: (scale * (x - optimum) ** 2).sum(1), 10, 80, seed)
    np.testing.assert_allclose(found.mean, optimum, atol=0.02)
    assert (found.std < 0.05).all()


def test_the_first_candidate_is_the_mean():
    distribution = CrossEntropy(np.array([0.5, -2.0]), 1.0, 0.1, 2)
    candidates = distribution.candidates(np.random.default_rng(0), 5)
    np.testing.assert_array_equal(candidates[0], np.array([0.5, -2.0], np.float32))
    assert len(np.unique(candidates, axis=0)) == 5


def test_an_update_by_hand():
    distribution = CrossEntropy(np.zeros(1), 1.0, 0.7, 2)
    candidates, costs = np.array([[5.0], [1.0], [3.0]], np.float32), np.array([9.0, 1.0, 2.0])
    distribution.update(candidates, costs, 0.35)  # half of the time in which there is an extra deviation
    assert distribution.mean == pytest.approx([2.0])
    assert distribution.std == pytest.approx([np.sqrt(2.0 + 0.35**2)])
    distribution.update(candidates, costs, 0.7)
    assert distribution.std == pytest.approx([np.sqrt(2.0)])
