"""The response by hand: one agent meets the deviation, several share it, effort and limits hold it back."""

import numpy as np
import pytest

from dcgrid_env.baselines.model_aided.best_response import best_response
from dcgrid_env.baselines.model_aided.expected_cost import VoltagePrice

PRICE = VoltagePrice(voltage=100.0, violation=1000.0, band_pu=0.05)


def response(v, by_all, effort=0.0, share=0.0, limit=1.0, hold=0.0, rest=0.0):
    """Of one agent at one bus whose whole limit moves the voltage by 0.04 p.u."""
    cell = np.full((1, 1, 1), 1.0)
    row = np.full((1, 1), 1.0)
    args = (v * cell, 0.001 * cell, by_all * cell, 0.04 * cell, share * row, limit * row)
    return float(best_response(PRICE, *args, np.array([effort]), hold, rest * row, halvings=30)[0, 0])


def test_one_agent_alone_brings_its_bus_to_the_nominal_voltage():
    assert response(0.98, by_all=0.04) == pytest.approx(0.5, abs=1e-6)
    assert response(1.01, by_all=0.04, share=0.25) == pytest.approx(
        0.0, abs=1e-2
    )  # the price of effort has its kink here


def test_where_all_move_alike_each_does_its_part():
    assert response(0.98, by_all=0.16) == pytest.approx(0.125, abs=1e-6)


def test_limits_and_effort_hold_it_back():
    assert response(0.9, by_all=0.04, limit=0.6) == pytest.approx(0.6, abs=1e-6)
    assert response(0.999, by_all=0.04, effort=5.0) == pytest.approx(0.0, abs=1e-2)


def test_the_pull_decides_where_the_voltage_says_nothing():
    assert response(1.0, by_all=0.0, hold=1.0, rest=0.3) == pytest.approx(0.3, abs=1e-6)
