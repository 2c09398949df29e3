"""The response by hand: one agent meets the deviation, several share it, effort and limits hold it back; the normal
distribution and the slope of the kernels are those of ``expected_cost``."""

from itertools import product

import numpy as np
import pytest
from scipy.special import ndtr

from dcgrid_env.baselines.model_aided import response_kernels
from dcgrid_env.baselines.model_aided.expected_cost import VoltagePrice

PRICE = VoltagePrice(voltage=100.0, violation=1000.0, band_pu=0.05)


def response(v, by_all, effort=0.0, share=0.0, limit=1.0, hold=0.0, rest=0.0, s=0.001, short=True):
    """Setpoint and slope of one agent at one bus whose whole limit moves the voltage by 0.04 p.u.

    ``short`` is whether the kernels may take their shorter ways.
    """
    bus = np.ones(1)
    apart = short and PRICE.band_pu / s >= 8.0
    belief = ((v - 1.0) / s * bus, PRICE.band_pu / s * bus, apart, short, by_all / s * bus, 0.04 * bus)
    return response_kernels.respond(*belief, PRICE[:2], share, limit, effort, hold, rest)


def test_one_agent_alone_brings_its_bus_to_the_nominal_voltage():
    assert response(0.98, by_all=0.04)[0] == pytest.approx(0.5, abs=2e-3)
    assert response(1.01, by_all=0.04, share=0.25)[0] == pytest.approx(0.0, abs=2e-3)


def test_where_all_move_alike_each_does_its_part():
    assert response(0.98, by_all=0.16)[0] == pytest.approx(0.125, abs=2e-3)


def test_limits_and_effort_hold_it_back():
    assert response(0.9, by_all=0.04, limit=0.6)[0] == pytest.approx(0.6)
    assert response(1.1, by_all=0.04, limit=0.6)[0] == pytest.approx(-0.6)
    assert response(0.999, by_all=0.04, effort=5.0)[0] == 0.0
    assert response(0.98, by_all=0.04, effort=1.0, s=0.01)[0] < response(0.98, by_all=0.04, s=0.01)[0]


def test_the_pull_decides_where_the_voltage_says_nothing():
    assert response(1.0, by_all=0.0, hold=1.0, rest=0.3)[0] == pytest.approx(0.3, abs=1e-6)


def test_at_the_response_slope_and_price_of_effort_are_even():
    share, _ = response(0.97, by_all=0.06, effort=0.4, hold=0.2, rest=0.1, s=0.004)
    _, slope = response(0.97 + 0.06 * share, by_all=0.06, share=share, hold=0.2, rest=0.1, s=0.004)
    assert slope == pytest.approx(-0.4, abs=0.01)


def test_the_polynomial_is_the_normal_distribution():
    x = np.linspace(-9.0, 9.0, 2001)
    assert [response_kernels.half_normal(value) for value in x] == pytest.approx(ndtr(x) - 0.5, abs=4e-5)


@pytest.mark.parametrize("v", [0.93, 0.951, 0.98, 1.0, 1.03, 1.049, 1.08])
@pytest.mark.parametrize("s", [0.001, 0.01])
def test_the_slope_is_that_of_the_expected_cost(v, s):
    _, slope = response(v, by_all=0.04, s=s)
    assert slope == pytest.approx(0.04 * PRICE.slope(np.array(v), np.array(s)), abs=0.01)


@pytest.mark.parametrize("limit", [0.5, 1.0])
def test_the_shorter_ways_lead_to_the_same(limit):
    given = {"effort": 0.3, "hold": 0.1, "rest": 0.2, "s": 0.004, "limit": limit}
    for v, by_all, share in product((0.93, 0.97, 0.996, 1.0, 1.02, 1.06), (0.0, 0.05), (-1.0, -0.3, 0.0, 0.4, 1.0)):
        short, whole = (response(v, by_all, share=share, short=short, **given) for short in (True, False))
        assert short == pytest.approx(whole, abs=1e-12)
