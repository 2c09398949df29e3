"""The figures of a report against separate power flows and studies."""

import numpy as np
import pytest

from dcgrid_env import load_feeder
from dcgrid_env.apps.hosting.capacity_study import Study
from dcgrid_env.apps.hosting.connection_study import sections
from dcgrid_env.apps.hosting.connection_study.connection_report import answers, page, report_json, sections_of
from dcgrid_env.apps.hosting.connection_study.study_job import Job
from dcgrid_env.apps.hosting.connection_study.study_request import FluctuationLimits, StudyRequest
from dcgrid_env.apps.hosting.hosting import hosting_capacity
from dcgrid_env.core.work.local_pool import ONE_PROCESS
from dcgrid_env.powerflow import distflow
from dcgrid_env.scenario.on_feeder import scenario_on


@pytest.fixture(scope="module")
def job():
    feeder = load_feeder("ieee33")
    request = StudyRequest(
        feeder="ieee33", bus="12", mw=0.5, title="A <b> & c", leave_out=("day", "fluctuation", "ride-through")
    )
    scenario = scenario_on(feeder, "1 x 500 kW at 12", "none").replace(source_voltage_pu=1.04, split="test")
    study = Study(scenario=scenario, others=False, buses=("12", "18"), samples=2, window_s=10.0, settle_s=4.0)
    return Job(request, study)


def test_the_base_case_is_the_power_flow_at_nominal_load(job):
    feeder = load_feeder("ieee33")
    section = sections.base_case(job)
    solved = distflow(feeder, feeder.p_load_kw, feeder.q_load_kvar - feeder.capacitor_kvar, 1.04)
    rows = {row[0]: row[1:] for row in section.tables[0].rows}
    assert rows["lowest voltage"] == (f"{solved.v_pu.min():.4f} p.u.", feeder.bus_ids[int(solved.v_pu.argmin())])
    assert float(rows["losses"][0].split()[0]) == pytest.approx(float(solved.loss_kw), rel=1e-4)
    assert section.pictures[0][1].startswith(b"\x89PNG")


@pytest.mark.slow
def test_the_worst_window_is_the_one_with_the_least_margin(job):
    section = sections.worst_window(job)
    limits, metrics = section.tables
    assert metrics.header == ("metric", "unit", "none", "droop")
    shown = next(row for row in metrics.rows if row[0] == "lowest voltage")
    under = next(row for row in limits.rows if row[:1] == ("none",) and row[1].startswith("undervoltage"))
    assert float(under[2].split()[0]) == pytest.approx(float(shown[2]), abs=1e-3)
    assert under[-1] == ("kept" if float(under[2].split()[0]) >= 0.95 else "broken")
    assert f"the nearest limit is {under[1]} ({under[2]}, limit 0.95 p.u., {under[4]})" in section.answer


def test_sensitivities_go_the_way_that_they_must(job):
    (table,) = sections.sensitivity(job).tables
    mw = {name: float(size.removeprefix(">=")) for name, size, _ in table.rows}
    assert mw["source voltage -1 %"] < mw["as assumed"] < mw["source voltage +1 %"]
    assert mw["lowest allowed voltage 0.96 p.u."] < mw["as assumed"] < mw["lowest allowed voltage 0.94 p.u."]
    (only,) = hosting_capacity(job.study, ["none"]).snapshot[:1]
    assert mw["as assumed"] == only.capacity_mw


@pytest.mark.slow
def test_the_report_is_whole_escaped_and_says_what_was_left_out(job, tmp_path):
    file = tmp_path / "study.toml"
    file.write_text("x = 1\n")
    found, counted = hosting_capacity(job.study, ["none", "droop"]), []
    made = sections_of(job, found, file, ONE_PROCESS, lambda: counted.append(1))
    assert [s.name for s in made] == [
        "base-case", "capacity", "worst-window", "sensitivity", "not-checked", "checklists", "inputs",
    ]  # fmt: skip
    assert len(counted) == 3
    text = page(job, found, made)
    assert "A &lt;b&gt; &amp; c" in text
    assert "A <b>" not in text
    assert "http" not in text.replace("http-equiv", "")
    assert "Sections left out on request: day, fluctuation, ride-through." in text
    by_name = {c.bus: c for c in found.by_controller["none"]}
    fits = "fits" if by_name["12"].capacity_mw >= 0.5 else "does not fit"
    assert answers(job, found)[0].startswith(f"Without control, 0.5 MW at bus 12 {fits}: the bus carries")
    record = report_json(job, found, made)
    assert set(record["sections"]) == {s.name for s in made}
    assert record["answers"] == answers(job, found)


@pytest.mark.slow
def test_a_day_and_fluctuation_of_a_small_site(job):
    limits = FluctuationLimits(ramp_kw_per_s=20.0)
    small = Job(StudyRequest(feeder="ieee33", bus="12", mw=0.2, controllers=("none",), limits=limits), job.study)
    limits, day = sections.day(small).tables
    assert [row[0] for row in limits.rows] == [
        "minutes with a voltage below 0.95 p.u.", "minutes with a voltage above 1.05 p.u.", "losses",
    ]  # fmt: skip
    loss = next(row for row in day.rows if row[0] == "mean loss")
    assert float(loss[3]) > float(loss[2])
    (table,) = sections.fluctuation(small).tables
    assert [row[0] for row in table.rows] == ["none", "limit"]
    assert table.rows[-1][1:] == ("20", "3", "1")
    assert np.isfinite([float(cell) for cell in table.rows[0][1:]]).all()
    curve, sags = sections.ride_through(small).tables
    assert curve.rows[0] == ("below 0.9 p.u.", "10 s")
    lost = next(row for row in sags.rows if row[0] == "load lost in a step")
    assert float(lost[2]) == pytest.approx(200.0, rel=0.02)  # the whole rating
