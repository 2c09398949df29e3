"""The worst hours of loads, and the capacities that they bound, against a power flow of every hour."""

import numpy as np
import pytest

from dcgrid_env import load_feeder, make_scenario, scenario_on
from dcgrid_env.apps.hosting.capacity_study import Study
from dcgrid_env.apps.hosting.hosting import hosting_capacity
from dcgrid_env.apps.hosting.load_hours import load_hours, sampled_windows, window_begins, windows_text
from dcgrid_env.baselines.engineering import engineering_scenario
from dcgrid_env.powerflow import distflow
from dcgrid_env.traces import ProfileTable

SOURCE_PU, V_MIN_PU = 1.03, 0.94
HOURS = 24 * 10


def profiled(values, **fields):
    feeder = load_feeder("ieee33")
    table = ProfileTable(0.0, 3600.0, feeder.bus_ids[1:], values, "2026-01-05")
    profiles = {"file": table, "columns": "bus"} | fields

    def make(split):
        return scenario_on(feeder, "1 x 300 kW at 18", "none").replace(
            load_profiles=profiles, source_voltage_pu=SOURCE_PU, split=split
        )

    return engineering_scenario(make)


@pytest.fixture(scope="module")
def loads():
    """Loads of each bus by chance, and one hour of each end of the feeder at which this end alone is heavily loaded."""
    rng = np.random.default_rng(3)
    values = rng.uniform(0.2, 0.7, (HOURS, 32))
    values[50, 24:32] = 1.3  # buses 26 to 33
    values[97, 5:17] = 1.1  # buses 7 to 18
    values[170] = 0.75
    return values


def study_of(loads, **fields):
    settings = {"buses": ("18", "33", "22"), "samples": 4, "tolerance_mw": 0.01, "max_mw": 6.0, "v_min_pu": V_MIN_PU}
    return Study(scenario=profiled(loads), others=False, **(settings | fields))


def lowest_v_pu(feeder, loads, bus, mw):
    """Lowest voltage of each hour with a site, by single power flows."""
    found = []
    for share in loads:
        p, q = (np.r_[0.0, share * load[1:]] for load in (feeder.p_load_kw, feeder.q_load_kvar))
        p[feeder.index(bus)] += 1000.0 * mw
        found.append(distflow(feeder, p, q, SOURCE_PU).v_pu[1:].min())
    return np.array(found)


@pytest.mark.slow
def test_no_capacity_is_above_that_of_the_worst_of_all_hours(loads):
    study = study_of(loads)
    feeder = study.scenario.feeder
    found = hosting_capacity(study, ["none"])
    worst_hours = set()
    for bus, snapshot, capacity in zip(found.buses, found.snapshot, found.by_controller["none"], strict=True):
        assert 0.0 < capacity.capacity_mw <= snapshot.capacity_mw
        assert lowest_v_pu(feeder, loads, bus, snapshot.capacity_mw).min() >= V_MIN_PU
        beyond = lowest_v_pu(feeder, loads, bus, snapshot.capacity_mw + study.step_mw)
        assert beyond.min() < V_MIN_PU
        worst_hours.add(int(beyond.argmin()))
    assert worst_hours == {50, 97, 170}  # each bus has its own, and only that of bus 22 is the hour of the highest load
    assert worst_hours <= set(np.asarray(found.windows.hours)[4:].astype(int).tolist())
    assert found.windows.considered == HOURS


@pytest.mark.slow
def test_the_worst_hours_are_named_dated_and_stated(loads):
    study = study_of(loads)
    found = load_hours(study)
    named = {reason: found.hours[i] for i, reason in enumerate(found.reasons) if reason}
    feeder = study.scenario.feeder
    without = lowest_v_pu(feeder, loads, "18", 0.0)
    total = (loads * feeder.p_load_kw[1:]).sum(axis=1)
    assert named["lowest voltage"] == without.argmin()
    assert named["highest load"] == total.argmax() == 170
    text = windows_text(study, hosting_capacity(study, ["none"]).windows)
    assert text.startswith("Windows: 4, spread over all 240 hours of load profiles, and ")
    assert "2026-01-12 02:00 (highest load)" in text
    assert "2026-01-09 01:00" in text


@pytest.mark.slow
def test_days_of_training_count():
    """The peak is in a block of training days only."""
    loads = np.full((HOURS, 32), 0.4)
    loads[30] = 1.0
    calm, peaked = (
        hosting_capacity(study_of(values, buses=("18",)), ["none"]).by_controller["none"][0].capacity_mw
        for values in (np.full((HOURS, 32), 0.4), loads)
    )
    assert peaked < 0.6 * calm


@pytest.mark.slow
def test_a_study_at_nominal_load_says_so():
    study = study_of(np.full((HOURS, 32), 0.4), load="peak", buses=("18",))
    found = hosting_capacity(study, ["none"])
    assert {reason for reason in found.windows.reasons if reason} == {"nominal load"}
    assert windows_text(study, found.windows) == "Windows: 4 at nominal load with noise, and 1 without noise."


def test_sampled_windows_are_spread_over_all_hours():
    begins = np.sort(np.asarray(sampled_windows(study_of(np.full((HOURS, 32), 0.4), samples=48)).begin_h))
    assert begins[0] >= 0.0
    assert begins[-1] <= HOURS - 60.0 / 3600.0
    np.testing.assert_array_equal(np.floor(begins / (HOURS / 48.0)), np.arange(48))
    assert len(np.unique(np.floor(begins % 24.0))) > 20


@pytest.mark.parametrize(("step_s", "between"), [(10.0, "hold"), (900.0, "linear"), (900.0, "hold")])
def test_the_site_is_at_its_rating_in_the_worst_sample(step_s, between):
    feeder = load_feeder("ieee33")
    values = np.full((200, 32), 0.4)
    values[77] = 1.0
    table = ProfileTable(0.0, step_s, feeder.bus_ids[1:], values)
    scenario = scenario_on(feeder, "1 x 300 kW at 18", "none").replace(
        load_profiles={"file": table, "columns": "bus", "between": between, "days": "all"}, split="whole"
    )
    study = Study(scenario=scenario, others=False, buses=("18",), samples=1)
    worst_s = 77 * step_s
    (begin_h,) = window_begins(study, np.array([worst_s / 3600.0]))
    begin_s, end_s = (3600.0 * begin_h + at for at in study.full_load_s)
    last_s = worst_s + (step_s if between == "hold" else 0.0)
    assert begin_s <= last_s
    assert end_s >= worst_s


@pytest.mark.slow
def test_pv_makes_an_hour_of_highest_voltage_by_day():
    scenario = make_scenario("mixed", split="test")
    found = load_hours(Study(scenario=scenario, samples=1))
    (highest,) = (hour for hour, reason in zip(found.hours, found.reasons, strict=True) if "highest voltage" in reason)
    assert 5.0 < highest < 19.0
    assert len(found.every) == 96
