"""Hindsight where work is routed and has deadlines, and the rule that routes it."""

import numpy as np
import pytest

from dcgrid_env import action_layout, make_scenario
from dcgrid_env.baselines import NoControl, RouteToStrongest, find_controller, make_controller, rollout
from dcgrid_env.baselines.model_based.hindsight import hindsight
from helpers.routing import routed


@pytest.mark.parametrize("order", ["edf", "fcfs"])
@pytest.mark.slow
def test_the_replay_is_near_the_bound_and_better_than_laws(order):
    levels = {"target_s": 1.0, "deadline_s": 6.0, "order": order}
    s = make_scenario("routing", split="validation", horizon=20, datacenters={"service": levels})
    found = hindsight(s, 0)
    assert found.bound <= found.J * (1.0 + 1e-4)
    assert found.gap < 0.01 * found.J
    laws = [NoControl(), make_controller("droop"), make_controller("route-to-strongest")]
    assert found.bound < min(float(rollout(s, law, [0]).costs()[0]) for law in laws)
    assert found.recorder.metrics()[0]["moved_kws"] > 0.0


@pytest.mark.slow
def test_without_deadlines_waiting_has_its_price_and_routing_is_worth_something():
    s = routed("bursty", horizon=15, datacenters={"batching": None, "service": None})
    stays = hindsight(s.replace(datacenters={"routing": None}), 1)
    moves = hindsight(s, 1)
    assert moves.J < stays.J
    assert moves.gap < 0.01 * moves.J
    held = hindsight(s.replace(datacenters={"routing": {"movable_share": 0.0}}), 1)
    assert pytest.approx(stays.J, rel=1e-4) == held.J


@pytest.mark.slow
def test_late_work_in_the_program_is_late_work_in_the_environment():
    # Work that is worth leaving late: lateness is cheap, and so is what is left.
    levels = {"target_s": 0.0, "deadline_s": 2.0, "late_weight": 0.02}
    weights = {"backlog": 0.0, "leftover": 0.5}
    s = make_scenario("routing", split="validation", horizon=15, datacenters={"service": levels}, weights=weights)
    found = hindsight(s, 3)
    metrics = found.recorder.metrics()[0]
    assert metrics["cost_late"] > 0.0
    assert abs(found.gap) < 0.02 * found.J


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({}, "hindsight plans no batch sizes, whose energy is no linear function; scenario 'ieee33' has batching"),
        (
            {"datacenters.batching": None, "datacenters.boost_share": 1.2},
            "sites that stay within their rating",
        ),
    ],
)
def test_what_it_cannot_plan_it_refuses_by_name(changes, message):
    with pytest.raises(ValueError, match=message):
        hindsight(routed(**changes), 0)


def test_beside_regulators_that_are_agents_it_plans_no_routing():
    s = make_scenario("ieee123-3ph-day", horizon=3, datacenters={"routing": {}})
    with pytest.raises(ValueError, match="routing and service levels beside fixed or controlled equipment alone"):
        hindsight(s, 0)


def test_the_rule_sends_work_to_the_strongest_bus():
    s = make_scenario("routing", horizon=3)
    law = find_controller("route-to-strongest", s)
    law.reset(s)
    metrics = rollout(s, law, range(4)).metrics()
    plain = rollout(s, make_controller("droop"), range(4)).metrics()
    assert all(m["moved_kws"] > 0.0 for m in metrics)
    assert np.mean([m["voltage_min_pu"] for m in metrics]) > np.mean([m["voltage_min_pu"] for m in plain])
    assert action_layout(s).is_channel("route").sum() == 4
    with pytest.raises(ValueError, match="route-to-strongest: the sites of scenario 'ieee33' have no channel 'route'"):
        rollout(make_scenario("ieee33"), make_controller("route-to-strongest"), [0])
    with pytest.raises(ValueError, match="route-to-strongest: route_gain_per_pu is -1"):
        RouteToStrongest(route_gain_per_pu=-1.0)
