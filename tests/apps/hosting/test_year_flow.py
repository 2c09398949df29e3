"""A year of power flows against separate power flows, and its worst hours by hand."""

import dataclasses

import numpy as np
import pytest

from dcgrid_env import load_feeder, scenario_on
from dcgrid_env.apps.hosting.year_flow import hour_scenario, year_flow
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.baselines.rollout import rollout
from dcgrid_env.powerflow import distflow
from dcgrid_env.traces import ProfileTable


def scenario(values, begin_h=0.0, first_day="", feeder=None):
    feeder = feeder or load_feeder("ieee33")
    buses = feeder.bus_ids[1:]
    table = ProfileTable(begin_h, 3600.0, tuple(buses), values * np.ones(len(buses)), first_day)
    s = scenario_on(feeder, "1 x 300 kW at 18", "none")
    return s.replace(load_profiles={"file": table, "columns": "bus", "days": "all"}, source_voltage_pu=1.03)


def test_every_sample_is_the_power_flow_of_its_loads():
    rng = np.random.default_rng(0)
    shares = rng.uniform(0.2, 1.1, (61, 1))  # two days and a half, from 5 h on
    s = scenario(shares, begin_h=5.0)
    done = []
    flow = year_flow(s, lambda n, of: done.append((n, of)))
    feeder = s.feeder
    p, q = shares * feeder.p_load_kw, shares * feeder.q_load_kvar
    p[:, feeder.index("18")] += 300.0
    for k in range(61):
        solved = distflow(feeder, p[k], q[k] - feeder.capacitor_kvar, 1.03)
        assert flow.v_min_pu[k] == pytest.approx(solved.v_pu[1:].min(), abs=1e-8)
        assert flow.v_max_pu[k] == pytest.approx(solved.v_pu[1:].max(), abs=1e-8)
        assert flow.loss_kw[k] == pytest.approx(float(solved.loss_kw), abs=1e-4)
    assert flow.solved.all()
    assert flow.hours[0] == 5.0
    assert flow.loss_mwh == pytest.approx(flow.loss_kw.sum() / 1000.0)
    assert done[-1] == (72, 72)
    limit = float(np.sort(flow.v_min_pu)[10])
    counted = flow.hours_outside(limit, 1.05, 1.0)
    assert counted["below the lowest voltage"] == 10.0
    assert counted["above the rating"] == 0.0


@pytest.mark.slow
def test_the_worst_hours_are_found_dated_and_simulated():
    shares = np.full((48, 1), 0.5)
    shares[31], shares[7] = 1.2, 0.1
    s = scenario(shares, first_day="2025-02-28")
    flow = year_flow(s)
    assert flow.worst() == {"lowest voltage": 31, "highest voltage": 7, "highest loss": 31}
    assert flow.time_text(31) == "2025-03-01 07:00"
    assert flow.value("lowest voltage", 31).endswith(" p.u. at 18")
    hour = hour_scenario(s, flow, 31)
    assert (hour.horizon, hour.dt_s, hour.load_profiles.start_h) == (3600, 1.0, 31.0)
    short = hour.replace(horizon=1300, background={"load_sigma": 0.0})
    run = rollout(short, NoControl(), [0]).series(0)
    assert run.v_pu[1250].min() == pytest.approx(flow.v_min_pu[31], abs=1e-6)  # the site at its rating from 1200 s on


def test_a_rating_is_compared_and_a_day_without_a_solution_is_counted():
    feeder = load_feeder("ieee33")
    rated = dataclasses.replace(feeder, rating_a=np.full(feeder.n_branch, 150.0))
    shares = np.full((48, 1), 0.4)
    shares[3], shares[30] = 1.0, 30.0
    flow = year_flow(scenario(shares, feeder=rated))
    assert flow.worst()["highest loading"] == 3
    assert flow.value("highest loading", 3).startswith(f"{100.0 * flow.loading[3]:.1f} % at ")
    counted = flow.hours_outside(0.5, 1.05, 1.0)
    assert counted["above the rating"] == float((flow.loading > 1.0).sum())
    assert counted["without a solution, or after one in the day"] == 18.0
    assert flow.solved.sum() == 30
    with pytest.raises(ValueError, match=r"draws the buses of its devices .* give them with datacenters.buses"):
        year_flow(scenario(shares).replace(datacenters={"buses": None}))
    with pytest.raises(ValueError, match=r"has no load profiles; give load_profiles.file"):
        year_flow(scenario_on(feeder, "1 x 300 kW at 18", "none"))
