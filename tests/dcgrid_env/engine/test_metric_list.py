"""How metrics are shown: every one of an episode has its entry, its digits and the way that is better."""

import pytest

from dcgrid_env import METRICS, Metric, make_scenario
from dcgrid_env.baselines import NoControl, rollout
from helpers.riding import riding
from helpers.storages import toy6_storage
from helpers.three_phase import ieee13

OF_REQUESTS = {name for name in METRICS if name.startswith(("requests", "ttft", "e2e"))}
OF_THREE_PHASES = {"cost_unbalance", "cost_switching", "unbalance_mean_pct", "unbalance_max_pct"}
OF_STORAGE = {name for name in METRICS if name.startswith("stor")} | {"cost_ageing", "cost_missing"}
OF_THREE_PHASES |= {"nema_unbalance_max_pct", "tap_moves", "capacitor_switchings"}
OF_LIMITS = {"cost_ramp_excess", "ramp_max_kw_per_s", "ramp_excess_pct"}
OF_LIMITS |= {"cost_voltage_step_excess", "voltage_step_max_pu", "voltage_step_excess_pct"}
OF_TENTHS = {"pst_max", "swing_share_max_pct", "swing_rms_max_pct"}
"""What takes steps of 0.1 s for 600 s."""
LIMITED = {
    "ramp_limit_kw_per_s": 10.0,
    "voltage_step_limit_pu": 0.02,
    "weights": {"ramp_excess": 1.0, "voltage_step_excess": 1.0},
}
OF_LEAVING = {name for name in METRICS if name.startswith(("ups", "inverter", "battery"))}
OF_LEAVING |= {"cost_trips", "cost_inverter_trips", "cost_away", "cost_recharge", "voltage_after_loss_max_pu"}


@pytest.mark.parametrize(
    ("scenario", "without"),
    [
        (
            make_scenario("toy6", horizon=3),
            OF_REQUESTS | OF_THREE_PHASES | OF_LIMITS | OF_TENTHS | OF_STORAGE | OF_LEAVING,
        ),
        (
            make_scenario("toy6", horizon=3, **LIMITED),
            OF_REQUESTS | OF_THREE_PHASES | OF_TENTHS | OF_STORAGE | OF_LEAVING,
        ),
        (
            make_scenario("toy6", horizon=6000, dt_s=0.1),
            OF_REQUESTS | OF_THREE_PHASES | OF_LIMITS | OF_STORAGE | OF_LEAVING,
        ),
        (
            make_scenario("ieee33", horizon=3, trace="deepseek-v3"),
            OF_THREE_PHASES | OF_LIMITS | OF_TENTHS | OF_STORAGE | OF_LEAVING,
        ),
        (ieee13().replace(horizon=3), OF_REQUESTS | OF_LIMITS | OF_TENTHS | OF_STORAGE | OF_LEAVING),
        (toy6_storage(3), OF_REQUESTS | OF_THREE_PHASES | OF_LIMITS | OF_TENTHS | OF_LEAVING),
        (riding(horizon=3), OF_REQUESTS | OF_THREE_PHASES | OF_LIMITS | OF_TENTHS | OF_STORAGE),
    ],
    ids=["balanced", "limits", "tenths of a second", "requests", "three phases", "storage", "leaving"],
)
def test_every_metric_of_an_episode_is_listed_and_none_besides(scenario, without):
    own = rollout(scenario, NoControl(), [0]).metrics()[0]
    assert set(own) == set(METRICS) - without
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
