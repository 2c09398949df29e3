"""The expected cost's slope against the integral that it is the derivative of, and at its limits."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from dcgrid_env import make_scenario
from dcgrid_env.baselines.model_aided.expected_cost import VoltagePrice

PRICE = VoltagePrice(voltage=100.0, violation=1000.0, band_pu=0.05)


def expected(v_pu, s_pu):
    def cost(v):
        e = abs(v - 1.0)
        return (PRICE.voltage * e + PRICE.violation * max(e - PRICE.band_pu, 0.0)) * norm.pdf(v, v_pu, s_pu)

    kinks = [p for p in (0.95, 1.0, 1.05) if abs(p - v_pu) < 8.0 * s_pu]
    return quad(cost, v_pu - 8.0 * s_pu, v_pu + 8.0 * s_pu, points=kinks or None, limit=200)[0]


@pytest.mark.parametrize("v_pu", [0.93, 0.951, 0.97, 1.0, 1.012, 1.05, 1.08])
@pytest.mark.parametrize("s_pu", [0.002, 0.01])
def test_the_slope_is_the_derivative_of_the_expected_cost(v_pu, s_pu):
    step = 1e-5
    slope = (expected(v_pu + step, s_pu) - expected(v_pu - step, s_pu)) / (2.0 * step)
    assert PRICE.slope(np.array(v_pu), np.array(s_pu)) == pytest.approx(slope, abs=0.05)


def test_a_voltage_that_is_known_has_the_slope_of_the_cost_itself():
    v = np.array([0.9, 0.97, 1.03, 1.1])
    assert PRICE.slope(v, np.full(4, 1e-9)) == pytest.approx([-1100.0, -100.0, 100.0, 1100.0])


def test_prices_are_the_means_over_buses_taken_apart():
    price = VoltagePrice.from_scenario(make_scenario("ieee33"))
    assert price == VoltagePrice(100.0 / 32, 1000.0 / 32, 0.05)
