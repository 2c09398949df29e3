"""The answers as CSV, as plain data and as a table."""

import csv
import dataclasses
import io
import json

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.apps.hosting.capacity_output import (
    capacity_csv,
    capacity_table,
    record,
)
from dcgrid_env.apps.hosting.capacity_study import Study
from dcgrid_env.apps.hosting.hosting import Capacities
from dcgrid_env.apps.hosting.load_hours import with_worst_hours
from dcgrid_env.apps.hosting.site_search import BusCapacity


def capacity(controller, bus, mw, **fields):
    values = {
        "at_most": False, "limit": "undervoltage at bus 18", "delay_mean_s": 0.1234567890123, "delay_p95_s": 2.0,
        "unserved_pct": 0.5, "outside_pct": 0.0, "margin": 0.01, "smaller_fails_mw": (), "larger_carries_mw": (),
        "most_windows_mw": mw, "half_windows_mw": 2.0 * mw,
    }  # fmt: skip
    return BusCapacity(controller=controller, bus=bus, capacity_mw=mw, **(values | fields))


@pytest.fixture
def found():
    study = Study(scenario=make_scenario("ieee33", split="test"), others=False, samples=4, window_s=10.0, settle_s=2.0)
    own = (
        capacity("a, b", "2", 20.0, at_most=True, limit=""),
        capacity("a, b", "18", 0.3, smaller_fails_mw=(0.1, 0.2), larger_carries_mw=(1.5,)),
    )
    snapshot = (capacity("snapshot", "2", 7.5), capacity("snapshot", "18", 0.25))
    return Capacities(
        study, ("2", "18"), ("a, b",), {"a, b": own}, snapshot, with_worst_hours(study, {}), ("branch 1-2",),
        ("a, b: has its defaults",),
    )  # fmt: skip


def test_the_csv_has_every_figure(found):
    rows = list(csv.DictReader(io.StringIO(capacity_csv(found))))
    for row, one in zip(rows, [*found.snapshot, *found.by_controller["a, b"]], strict=True):
        assert (row["controller"], row["bus"], row["limit"]) == (one.controller, one.bus, one.limit)
        assert (float(row["capacity_mw"]), float(row["delay_mean_s"])) == (one.capacity_mw, one.delay_mean_s)
        assert (row["at_most"] == "true") == one.at_most
        assert tuple(float(size) for size in row["smaller_fails_mw"].split(";") if size) == one.smaller_fails_mw


def test_the_record_is_plain_and_whole(found):
    plain = json.loads(json.dumps(record(found)))
    assert plain["study"]["feeder"] == "ieee33"
    assert plain["study"]["buses"] == ["2", "18"]
    assert [c["capacity_mw"] for c in plain["capacities"]] == [7.5, 0.25, 20.0, 0.3]


def test_the_table_says_what_is_at_its_end_and_what_is_not_monotone(found):
    table = capacity_table(found)
    assert [row[:3] for row in table.rows] == [("2", "7.5", ">=20"), ("18", "0.25", "0.3*")]
    notes = "\n".join(table.notes)
    assert "* a, b, bus 18: smaller sites of 0.1, 0.2 MW break limits" in notes
    assert "* a, b, bus 18: larger sites of 1.5 MW keep within them" in notes
    assert "a, b: has its defaults" in notes
    assert "all sites are asked for their rating from 5 to 7 s" in notes
    assert "Overloaded without any site: branch 1-2." in notes


def test_what_was_not_checked_is_said_and_stored(found):
    rating_a = np.full(32, 200.0)
    rating_a[[3, 20]] = np.nan
    feeder = dataclasses.replace(found.study.scenario.feeder, rating_a=rating_a)
    study = dataclasses.replace(found.study, scenario=found.study.scenario.replace(feeder=feeder))
    some = dataclasses.replace(found, study=study)
    notes = "\n".join(capacity_table(some).notes)
    names = [feeder.branch_names[3], feeder.branch_names[20]]
    assert f"Ratings known for 30 of 32 elements; not checked: {', '.join(names)}." in notes
    plain = record(some)
    assert plain["ratings"] == {"known": 30, "of": 32, "not_checked": tuple(names), "basis": "", "otherwise": ()}
    assert plain["overloaded_without_site"] == ["branch 1-2"]
    assert "Ratings known for 0 of 32 elements; not checked: branch 1-2, " in "\n".join(capacity_table(found).notes)


def test_buses_without_an_answer_have_their_reason(found):
    study = Study(scenario=make_scenario("ieee123-3ph", split="test"), others=False, samples=4)
    left_out = study.left_out()
    feeder = study.scenario.feeder
    candidates = {feeder.bus_ids[at] for at in study.candidates()}
    assert set(left_out) | candidates == set(feeder.bus_ids[1:])
    assert not set(left_out) & candidates
    assert left_out["2"] == "of one phase"
    assert set(left_out.values()) == {"without load", "of one phase"}
    many = dataclasses.replace(study, scenario=make_scenario("khodr141", split="test"))
    assert len(many.candidates()) == 64
    assert any("beyond the 64 that are tried" in reason for reason in many.left_out().values())
    assert dataclasses.replace(study, buses=("60",)).left_out() == {}
    some = dataclasses.replace(found, study=study)
    assert record(some)["without_answer"] == left_out
    assert any(" buses, of one phase: " in note for note in capacity_table(some).notes)
