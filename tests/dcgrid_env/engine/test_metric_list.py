"""How metrics are shown: every one of an episode has its entry, its digits and the way that is better."""

import pytest

from dcgrid_env import METRICS, Metric, make_scenario
from dcgrid_env.baselines import NoControl, rollout


@pytest.mark.parametrize("trace", ["inference", "deepseek-v3"])
def test_every_metric_of_an_episode_is_listed_and_none_besides(trace):
    if trace == "inference":
        own = rollout(make_scenario("toy6", horizon=3), NoControl(), [0]).metrics()[0]
        assert set(own) == {name for name in METRICS if not name.startswith(("requests", "ttft", "e2e"))}
    else:
        own = rollout(make_scenario("ieee33", horizon=3, trace=trace), NoControl(), [0]).metrics()[0]
        assert set(own) == set(METRICS)
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
