"""Voltages of moments: with regulators that act, taps have settled as the built-in controls settle them."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env import Control, acting_relays, make_scenario, solver_for
from dcgrid_env.baselines.model_aided.commissioning import site_of
from dcgrid_env.baselines.model_aided.moment_flow import MomentFlow

INTEGRATING = {"regulator_settings": {"timer": "integrating", "offset_v": {"reg1": -2.4, "reg2": -5.7, "reg3": -1.7}}}


def flow_of(**overrides):
    scenario = make_scenario("ieee13-3ph", **overrides)
    site = site_of(scenario)
    fixed = [device.buses or () for device in scenario.devices if device.count]
    return MomentFlow(site, np.array([scenario.feeder.index(bus) for buses in fixed for bus in buses]))


def at_rest(flow, q_kvar, first_q_kvar):
    """Voltages with the taps that the relays reach under some set points, then under others."""
    s, points = flow.scenario, flow.points
    relays: Any = acting_relays(s)
    p_kw = points.p_load_kw + points.p_agent_kw @ flow.shares
    loads = [points.q_load_kvar - q @ flow.shares for q in (0.0 * q_kvar, first_q_kvar, q_kvar)]
    tap = None
    for q_load_kvar in loads[:2]:
        tap = relays.settled(s.feeder, p_kw, q_load_kvar, s.source_voltage_pu, tap)
    solve = solver_for(s.feeder, s.power_flow)
    solution = solve(s.feeder, p_kw, loads[2], s.source_voltage_pu, Control(s.feeder.tap_ratio(tap)))
    return solution.v_pu[:, s.feeder.load_slice], relays.volts(solution), relays


def test_taps_settle_under_the_set_points():
    flow = flow_of()
    q_kvar = np.tile(-0.8 * flow.scenario.q_scale_kvar, (len(flow.points.p_load_kw), 1))
    v_pu, relay_v, relays = at_rest(flow, q_kvar, q_kvar)
    np.testing.assert_allclose(flow.voltages(q_kvar), v_pu, atol=1e-9)
    low, high = relays.band_volts
    assert ((relay_v > low) & (relay_v < high)).all()
    without_taps = at_rest(flow, q_kvar, 0.0 * q_kvar)[0]
    assert np.abs(without_taps - v_pu).max() > 0.005


@pytest.mark.slow
def test_taps_that_answer_within_a_step_stay_as_without_reactive_power():
    flow = flow_of(dt_s=60.0, background={"start_hour": 6.0})
    q_kvar = np.tile(-0.8 * flow.scenario.q_scale_kvar, (len(flow.points.p_load_kw), 1))
    np.testing.assert_allclose(flow.voltages(q_kvar), at_rest(flow, q_kvar, 0.0 * q_kvar)[0], atol=1e-9)


@pytest.mark.parametrize("regulators", ["fixed", "controlled"])
def test_base_taps_are_those_of_the_table_only_where_no_regulator_acts(regulators):
    flow = flow_of(grid_control={"regulators": regulators} | INTEGRATING, weights={"switching": 0.0})
    q_kvar = np.zeros((len(flow.points.p_load_kw), flow.scenario.n_agents))
    s, points = flow.scenario, flow.points
    p_kw = points.p_load_kw + points.p_agent_kw @ flow.shares
    solution = solver_for(s.feeder, s.power_flow)(s.feeder, p_kw, points.q_load_kvar, s.source_voltage_pu)
    same = np.allclose(flow.voltages(q_kvar), solution.v_pu[:, s.feeder.load_slice], atol=1e-9)
    assert same == (regulators == "fixed")
