"""Display of metrics: every metric of an episode has an entry, digits and a better direction."""

import dataclasses

import numpy as np
import pytest

from dcgrid_env import METRICS, Metric, load_feeder, make_scenario
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.scenario.costs.grid_terms import TERMS
from helpers.riding import riding
from helpers.storages import toy6_storage
from helpers.three_phase import ieee13


def named(*beginnings: str) -> set[str]:
    return {name for name in METRICS if name.startswith(beginnings)}


LIMITED = {
    "cost.ramp_limit_kw_per_s": 10.0,
    "cost.voltage_step_limit_pu": 0.02,
    "weights": {"ramp_excess": 1.0, "voltage_step_excess": 1.0},
}
ASKED = {"grid_request": {"targets": [{"value_share": 0.5}]}, "weights": {"grid_request": 1.0}}
RATED = dataclasses.replace(load_feeder("toy6"), rating_a=np.full(5, 100.0))
SITES = {f"datacenters.{name}": {} for name in ("smoothing", "cooling", "routing", "batching", "service")} | {
    "datacenters.storage": {"p_rated_kw": 300.0, "energy_kwh": 5.0}
}
GROUPS = {
    "requests": named("requests", "ttft", "e2e"),
    "phases": named("unbalance", "nema", "tap_moves", "capacitor_switchings", "cost_unbalance", "cost_switching"),
    "requests of a utility": named("grid_request", "cost_grid_request"),
    "limits": named("ramp", "voltage_step_max", "voltage_step_excess", "cost_ramp", "cost_voltage_step"),
    "ratings": named("loading_max", "overloaded", "cost_overload"),
    "tenths": named("pst", "swing"),
    "storage": named("stor") | {"cost_ageing", "cost_missing"},
    "leaving": named("ups", "inverter", "battery", "voltage_after_loss")
    | {"cost_trips", "cost_inverter_trips", "cost_away", "cost_recharge"},
    "smoothing": named("burnt", "held_back", "floor_mean", "cost_burnt"),
    "cooling": named("cooling", "pue"),
    "routing": named("moved", "cost_moving"),
    "batching": named("batch", "cost_gathering"),
    "service": named("in_time", "interactive", "deferrable", "lateness", "cost_late"),
    "behind sites": named("site_", "cost_site_"),
}
"""Metrics that a scenario has or has not, together; tenths are steps of 0.1 s for 600 s."""
OF_SITES = {"smoothing", "cooling", "routing", "batching", "service", "behind sites"}


@pytest.mark.parametrize(
    ("scenario", "has"),
    [
        (make_scenario("toy6", horizon=3), set()),
        (make_scenario("toy6", horizon=3, **LIMITED), {"limits"}),
        (make_scenario("toy6", horizon=3, **ASKED), {"requests of a utility"}),
        (make_scenario("toy6", horizon=3, feeder=RATED, weights={"overload": 1.0}), {"ratings"}),
        (make_scenario("toy6", horizon=6000, dt_s=0.1), {"tenths"}),
        (make_scenario("ieee33", horizon=3, trace="deepseek-v3"), {"requests"}),
        (ieee13().replace(horizon=3, weights={"overload": 1.0}), {"phases", "ratings"}),
        (toy6_storage(3), {"storage"}),
        (riding(horizon=3), {"leaving"}),
        (make_scenario("toy6", horizon=3, **SITES), OF_SITES),
    ],
    ids=[
        "balanced",
        "limits",
        "requests of a utility",
        "ratings",
        "tenths of a second",
        "requests",
        "three phases",
        "storage",
        "leaving",
        "sites",
    ],
)
def test_every_metric_of_an_episode_is_listed_and_none_besides(scenario, has):
    own = rollout(scenario, NoControl(), [0]).metrics()[0]
    without = set().union(*(names for group, names in GROUPS.items() if group not in has))
    weights = scenario.cost.weights
    without |= {f"cost_{term.name}" for term in TERMS if not (term.is_always_listed or getattr(weights, term.name))}
    assert set(own) == set(METRICS) - without
    assert all(GROUPS.values())
    for name, metric in METRICS.items():
        assert metric.name == name


def test_a_value_is_shown_with_its_digits_and_scale():
    assert METRICS["J"].text(1.23456) == "1.2346"
    assert METRICS["J"].heading == METRICS["J"].column == "J"
    assert METRICS["voltage_step_mean_pu"].text(0.00123) == "1.23"
    assert METRICS["voltage_step_mean_pu"].heading == "1-step voltage change, 1e-3 p.u."
    assert METRICS["outside_bus_seconds_pct"].column == "outside, % of bus-s"


def test_worse_is_told_by_the_digits_that_are_shown():
    delay = METRICS["delay_mean_s"]
    assert delay.is_worse({"delay_mean_s": 1.01}, {"delay_mean_s": 1.0})
    assert not delay.is_worse({"delay_mean_s": 1.004}, {"delay_mean_s": 1.0})
    assert not delay.is_worse({"delay_mean_s": 1.0}, {"delay_mean_s": 1.01})
    clock = METRICS["clock_mean_pct"]
    assert clock.is_worse({"clock_mean_pct": 90.0}, {"clock_mean_pct": 95.0})
    steps = Metric("steps", "steps", "", 0, "neither")
    assert not steps.is_worse({"steps": 1}, {"steps": 2})
    assert not steps.is_worse({"steps": 2}, {"steps": 1})
