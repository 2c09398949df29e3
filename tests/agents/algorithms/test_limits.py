"""Limits of training: updates of their multipliers, and the best policy under them."""

import pytest

from dcgrid_env.agents.algorithms.analytic import Limits, updated_factor


def test_the_multiplier_stays_within_its_range():
    factor = 1.0
    for measured, expected in ((9.0, 1e3), (0.0, 1e-3), (1.0, 1e-3)):
        factor = updated_factor(factor, 1.0, measured, rate=50.0)
        assert factor == pytest.approx(expected)


def test_without_a_limit_the_multiplier_stays():
    assert updated_factor(0.7, None, 9.0, rate=50.0) == 0.7


def test_under_a_limit_the_rest_of_j_counts():
    figures = {"J": 3.0, "J_waiting": 1.0, "delay_mean_s": 1.5, "J_violation": 0.5, "excess_mean_pu": 2e-3}
    assert Limits(None, None).merit(figures) == 3.0
    assert Limits(2.0, None).merit(figures) == 2.0
    assert Limits(1.0, None).merit(figures) == pytest.approx(2.0 * 6.0)
    assert Limits(None, 1e-3).merit(figures) == pytest.approx(2.5 * 11.0)
