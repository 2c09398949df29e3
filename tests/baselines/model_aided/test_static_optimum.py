"""The smoothed cost against the exact one, its slope, and set points against a derivative-free search."""

import numpy as np
import pytest
from scipy.optimize import minimize

from dcgrid_env import forecast, make_scenario
from dcgrid_env.baselines.model_aided.commissioning import commission, site_of
from dcgrid_env.baselines.model_aided.moment_flow import MomentFlow
from dcgrid_env.baselines.model_aided.smoothed_cost import smoothed_cost

PRICES = (100.0, 1000.0, 0.05)


def test_away_from_its_kinks_the_rounded_cost_is_the_cost():
    e = np.array([[0.03, -0.08], [-0.02, 0.11], [0.04, -0.06]])
    beyond = np.maximum(abs(e) - 0.05, 0.0)
    total, slope = smoothed_cost(e, *PRICES, 1e-7)
    assert total == pytest.approx(100.0 * abs(e).sum() + 1000.0 * beyond.sum())
    assert slope == pytest.approx((100.0 * np.sign(e) + 1000.0 * np.sign(e) * (beyond > 0.0)).sum(axis=0))


@pytest.mark.parametrize("e", [-0.0502, -0.0499, -0.0001, 0.0, 0.0002, 0.03, 0.05, 0.0504, 0.3])
def test_its_slope_is_its_derivative(e):
    step = 1e-7
    more, less = (smoothed_cost(np.array([[e + by]]), *PRICES, 3e-4)[0] for by in (step, -step))
    assert smoothed_cost(np.array([[e]]), *PRICES, 3e-4)[1] == pytest.approx([(more - less) / (2.0 * step)], abs=1e-2)


def test_a_search_without_slopes_by_the_exact_power_flow_finds_nothing_that_costs_less():
    scenario = make_scenario("ieee33")
    site, buses = site_of(scenario), forecast(scenario, 0).buses
    rest_kvar, w = commission(site, buses[None]).rest_kvar[0, 0], scenario.cost.weights
    rows = np.random.default_rng(1).choice(len(site.points.sun), 12, replace=False)  # as commissioning draws them
    voltages = MomentFlow(site, buses).at_moments(rows)
    limit_kvar = site.limit_kvar(site.points.p_agent_kw).mean(axis=0)

    def cost(q_kvar):
        e = abs(voltages(q_kvar) - 1.0)
        beyond = np.maximum(e - scenario.cost.band_pu, 0.0).mean()
        return w.voltage * e.mean() + w.violation * beyond + site.effort @ abs(q_kvar / site.kvar_share)

    bounds = list(zip(-limit_kvar, limit_kvar, strict=True))
    other = minimize(cost, np.zeros_like(rest_kvar), bounds=bounds, method="Powell", options={"maxfev": 1500})
    assert (abs(rest_kvar) <= limit_kvar + 1e-9).all()
    assert cost(rest_kvar) == pytest.approx(other.fun, rel=2e-3)
    assert cost(rest_kvar) <= other.fun + 1e-4
    assert other.fun < 0.9 * cost(0.0 * rest_kvar)
