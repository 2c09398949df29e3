"""Sentences of a report about load level, dates, ratings and equipment hold in every situation."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from dcgrid_env import load_feeder, scenario_on
from dcgrid_env.apps.hosting.capacity_study import Study
from dcgrid_env.apps.hosting.connection_study import sections
from dcgrid_env.apps.hosting.connection_study.checklists import checklists, other_means
from dcgrid_env.apps.hosting.connection_study.connection_report import answers, confidence
from dcgrid_env.apps.hosting.connection_study.limit_distances import limit_values, time_of
from dcgrid_env.apps.hosting.connection_study.section import rise_or_fall, sentences
from dcgrid_env.apps.hosting.connection_study.study_job import Job
from dcgrid_env.apps.hosting.connection_study.study_request import StudyRequest
from dcgrid_env.apps.hosting.hosting import hosting_capacity
from dcgrid_env.apps.hosting.load_hours import sampled_windows
from dcgrid_env.apps.hosting.trial import LIMITS
from dcgrid_env.apps.hosting.worst_hours import study_windows
from dcgrid_env.powerflow import distflow
from dcgrid_env.traces import ProfileTable

SHORT = {"samples": 2, "window_s": 10.0, "settle_s": 4.0}


def table(share=0.1, days=10):
    """Profiles of ieee33: the same share in each hour."""
    buses = load_feeder("ieee33").bus_ids[1:]
    return ProfileTable(0.0, 3600.0, tuple(buses), np.full((24 * days, len(buses)), share), "2025-01-01")


def job(feeder=None, bus="12", profiles=None, scenario=None, study=None, **request):
    feeder = feeder or load_feeder("ieee33")
    on_it = scenario_on(feeder, f"1 x 100 kW at {bus}", "none").replace(**({"split": "test"} | (scenario or {})))
    if profiles:
        on_it = on_it.replace(load_profiles={"columns": "bus", **profiles})
    asked = StudyRequest(feeder=feeder.name, bus=bus, mw=0.1, controllers=("none",), **request)
    return Job(asked, Study(scenario=on_it, others=False, buses=(bus,), **SHORT, **(study or {})))


def rows(section, title):
    (found,) = [t for t in section.tables if t.title == title]
    return {row[0]: row for row in found.rows}


@pytest.mark.slow
def test_ride_through_is_at_nominal_load_whatever_the_load_profiles_have():
    section = sections.ride_through(job(profiles={"file": table()}))
    feeder = load_feeder("ieee33")
    nominal_kw = float(distflow(feeder, feeder.p_load_kw, feeder.q_load_kvar - feeder.capacitor_kvar, 1.0).loss_kw)
    assert "at nominal load" in section.paragraphs[0]
    assert float(rows(section, "Metrics of the sags")["mean loss"][2]) > 0.9 * nominal_kw


@pytest.mark.slow
def test_times_of_load_profiles_are_dates():
    profiles = table()
    peaked = profiles.values.copy()
    peaked[6 * 24 + 7] = 0.9  # a day of training
    found = job(profiles={"file": dataclasses.replace(profiles, values=peaked)}, scenario={"split": "whole"})
    windows = study_windows(found.study, 11, 1)
    times = [time_of(found.study, windows, window) for window in range(len(windows))]
    assert "2025-01-07 07:00" in times[found.study.samples :]
    assert {time.split(" ")[0] for time in times} <= {f"2025-01-{day:02d}" for day in range(1, 11)}
    (text,) = sections.day(found).paragraphs
    assert text.startswith("The day from 2025-01-07 00:00 on, in which a power flow of each sample without the site")
    begun = job(profiles={"file": profiles, "start_h": 4 * 24 + 7.5}, scenario={"split": "whole"})
    assert time_of(begun.study, sampled_windows(begun.study), 1) == "2025-01-05 07:30"
    assert "from 2025-01-05 00:00 on" in sections.day(begun).paragraphs[0]
    standard, peak = job(), job(study={"load": "peak"})
    assert time_of(standard.study, sampled_windows(standard.study), 0) == "11:30"
    assert time_of(peak.study, sampled_windows(peak.study), 0) == "nominal load"


def test_ratings_that_are_all_known_leave_nothing_unchecked():
    bare, rated = load_feeder("ieee33"), dataclasses.replace(load_feeder("ieee33"), rating_a=np.full(32, 400.0))
    assert "Ratings are known for 0 of 32 elements; the others were not checked." in confidence(job(bare), None)
    assert "Ratings are known for 32 of 32 elements. Faults" in confidence(job(rated), None)
    subjects = [[row[0] for row in other_means(job(feeder).study.coverage).rows] for feeder in (bare, rated)]
    assert set(subjects[0]) - set(subjects[1]) == {"elements without a rating"}
    assert "windows" not in confidence(job(leave_out=("capacity",)), None)


def test_a_capacity_of_0_names_limits_that_are_broken_without_a_site():
    found = job(scenario={"source_voltage_pu": 1.0})
    (said,) = answers(found, hosting_capacity(found.study, ["none"]))
    assert said.endswith("the bus carries 0 MW. Limits are broken without any site: undervoltage at bus 18.")


@pytest.mark.slow
def test_equipment_that_acts_is_named():
    feeder = load_feeder("ieee13-3ph")
    said = {
        "Nothing is controlled except regulators.": {},
        "Nothing is controlled.": {"grid_control": {"regulators": "fixed"}},
        "Nothing is controlled except regulators and capacitor banks.": {"grid_control": {"capacitors": "controlled"}},
    }
    for text, changes in said.items():
        assert sections.base_case(job(feeder, "671", scenario=changes)).paragraphs[0].endswith(text)
    assert sections.base_case(job()).paragraphs[0].endswith("Nothing is controlled.")


def test_checklists_do_not_refer_to_a_section_that_was_left_out():
    cells = [cell for found in checklists(("ride-through",)) for row in found.rows for cell in row]
    assert "load lost and voltages after recorded sags" not in cells
    assert "load lost and voltages after recorded sags" in [c for t in checklists(()) for row in t.rows for c in row]


def test_losses_rise_or_fall():
    assert (rise_or_fall(2.0, 1.0), rise_or_fall(1.0, 2.0)) == ("fall", "rise")


def test_levels_of_loads_and_lengths_of_steps_are_named():
    profiles: Any = {"profiles": {"file": table()}}
    nominal: Any = {"load": "peak"}
    half_s: Any = {"scenario": {"dt_s": 0.5}, "study": {"voltage_step_max_pct": 3.0}}
    words = [job(**each).study.load_words for each in ({"study": nominal}, {}, profiles)]
    assert words == ["nominal load", "day load", "load profiles"]
    assert job(study=nominal, **profiles).study.load_words == "nominal load"
    assert limit_values(job(**half_s).study, LIMITS.index("voltage step"), 0.5) == ("1.5 % in 0.5 s", "3 % in 0.5 s")
    assert sentences(("source at 1.03 p.u.", "from the file")) == "Source at 1.03 p.u. From the file."
