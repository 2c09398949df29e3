"""Recordings with dates begin at the date or time of day of the episode."""

from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from dcgrid_env import forecast, make_scenario, recording_lines, scenario_hash
from dcgrid_env.engine.exogenous import episode
from dcgrid_env.engine.exogenous.clock_starts import row_clocks
from dcgrid_env.traces import PowerTrace, ProfileTable, Provenance

DT_S, HORIZON = 60.0, 30
DAYS = 3


def dated(first_day="2026-03-02", hours=24.0 * DAYS, begin="00:00", name="log", **noted):
    """A recording whose power in kW is the number of hours since the midnight before it."""
    first_h = int(begin[:2]) + int(begin[3:]) / 60.0
    time_s = np.arange(0.0, 3600.0 * hours + 1.0, DT_S)
    power_kw = first_h + time_s / 3600.0
    parameters = {"began": f"{first_day}T{begin}:00.000"} | noted
    return PowerTrace(time_s, power_kw, name, Provenance(name, None, parameters), rated_kw=100.0)


def scenario(*traces, split="whole", start_h=None, first_day="2026-03-01", offset_h=None, days=10, **fields):
    feeder = make_scenario("ieee33-weak").feeder
    table = ProfileTable(0.0, 900.0, feeder.bus_ids[1:], np.full((96 * days, 32), 0.5), first_day, offset_h)
    profiles = {"file": table, "columns": "bus", "days": "all", "start_h": start_h}
    return make_scenario(
        "ieee33-weak", load_profiles=profiles, trace=traces, split=split, horizon=HORIZON, dt_s=DT_S,
        datacenters={"idle_share": 0.0, "buses": (18,)}, n_datacenters=1, **fields,
    )  # fmt: skip


def hour_of_log(s, seed):
    """Hours since the midnight before the recording, which its power is, in the first step of an episode."""
    return forecast(s, seed).p_ref_kw[0, 0] / s.site_rated_kw[0] * 100.0


def test_an_episode_begins_at_its_date_and_time_of_day():
    """The log begins a day after the load profiles: 36.25 h of these are 12:15 of its first day."""
    for begin_h, wanted_h in ((36.25, 12.25), (24.0, 0.0), (61.5, 37.5)):
        for seed in range(3):
            found = hour_of_log(scenario(dated(), start_h=begin_h), seed)
            assert found == pytest.approx(wanted_h + DT_S / 3600.0, abs=1e-6)


@pytest.mark.parametrize(("split", "days"), [("whole", {0, 1, 2}), ("test", {2})])
def test_an_episode_at_another_date_begins_at_its_time_of_day(split, days):
    s = scenario(dated(), start_h=212.25, split=split)  # beyond the log, at 20:15
    found = np.array([hour_of_log(s, seed) for seed in range(12)])
    np.testing.assert_allclose(found % 24.0, 20.25 + DT_S / 3600.0, atol=1e-6)
    assert set(np.floor(found / 24.0).astype(int)) == days


def test_profiles_without_dates_give_a_time_of_day():
    s = scenario(dated(), start_h=36.25, first_day="")
    assert {round(hour_of_log(s, seed) % 24.0, 2) for seed in range(10)} == {12.27}


def test_the_scenario_of_a_day_gives_a_time_of_day():
    s = make_scenario(
        "ieee33-weak", trace=(dated(),), split="whole", horizon=HORIZON, dt_s=DT_S, background={"start_hour": 8.25},
        datacenters={"idle_share": 0.0, "buses": (18,)}, n_datacenters=1,
    )  # fmt: skip
    assert {round(hour_of_log(s, seed) % 24.0, 2) for seed in range(10)} == {8.27}


@pytest.mark.parametrize(
    ("noted", "offset_h", "wanted_h"),
    [
        ({"utc_offset_h": 0.0}, 1.0, 11.25),  # 12:15 at +01:00 is 11:15 in UTC
        ({"utc_offset_h": 0.0}, None, 12.25),
        ({}, 1.0, 12.25),
        ({"utc_offset_h": 2.0}, None, 10.25),  # the log's 12:15 at +02:00 is 10:15 in UTC, in which it is noted
        ({"utc_offset_h": 2.0}, 2.0, 10.25),
    ],
)
def test_utc_offsets_that_both_files_state_are_accounted_for(noted, offset_h, wanted_h):
    s = scenario(dated(**noted), start_h=36.25, offset_h=offset_h)
    assert hour_of_log(s, 0) == pytest.approx(wanted_h + DT_S / 3600.0, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("stamps", ["offsets", "local"])
@pytest.mark.parametrize("noted", [{}, {"utc_offset_h": 2.0}])
def test_summer_time_of_load_profiles_is_accounted_for(stamps, noted, tmp_path):
    """On the clock of the profiles' first sample in winter, 12:15 of a summer day is 11:15."""
    zone, begin = ZoneInfo("Europe/Berlin"), datetime(2026, 3, 1, tzinfo=ZoneInfo("Europe/Berlin"))
    times = [(begin.astimezone(UTC) + timedelta(hours=i)).astimezone(zone) for i in range(24 * 70)]
    stamp = datetime.isoformat if stamps == "offsets" else lambda at: at.replace(tzinfo=None).isoformat()
    file = tmp_path / "loads.csv"
    file.write_text("time,home\n" + "".join(f"{stamp(at)},0.5\n" for at in times))
    classes = dict.fromkeys(make_scenario("ieee33-weak").feeder.bus_ids[1:], "home")
    wanted = datetime(2026, 5, 2, 12, 15, tzinfo=zone)
    start_h = (wanted.astimezone(UTC) - begin.astimezone(UTC)) / timedelta(hours=1)
    profiles = {"file": str(file), "columns": "class", "classes": classes, "days": "all", "start_h": start_h}
    log = dated("2026-05-01", **noted) if not noted else dated("2026-04-30", begin="22:00", **noted)
    s = scenario(log).replace(load_profiles=profiles)
    assert s.load_profiles.table.time_text(start_h) == "2026-05-02 12:15"
    shown_h = hour_of_log(s, 0) - (0.0 if not noted else 22.0)  # hours since the log's local midnight
    assert shown_h == pytest.approx(36.25 + DT_S / 3600.0, abs=1e-6)
    stated = any("not all of the files state UTC offsets" in line for line in recording_lines(s))
    assert stated == ((stamps == "offsets") != bool(noted))


def test_recordings_of_different_length_share_the_clock_and_keep_their_rows():
    s = scenario(dated(hours=30.0, name="a"), dated(hours=70.0, name="b"), start_h=36.25)
    assert {round(hour_of_log(s, seed), 2) for seed in range(20)} == {12.27}


@pytest.mark.parametrize(
    ("trace", "fields", "said"),
    [
        (dated(), {"start_h": 36.25}, "trace log: runs on the clock of the load profiles: 100 % of episodes begin at "
         "the date and time of day"),
        (dated(), {"start_h": 200.0}, "of the load profiles: 100 % of episodes begin at the time of day"),
        (dated(hours=1.0), {"start_h": 200.0}, "trace log: does not run on the clock of the load profiles: 100 % of "
         "episodes begin at random"),
        (dated(), {}, "trace log: runs on the clock of the load profiles: 2"),
        (PowerTrace([0.0, 9000.0], [1.0, 1.0], "csv"), {}, "trace csv: has no dates, so it does not run on the clock"),
        (dated(), {"workload": {"window": "start"}}, "trace log: begins at its first sample"),
        (dated(hours=0.25), {"start_h": 36.25}, "trace log: lasts 900 s and episodes need 1920 s, so it is repeated"),
    ],
)  # fmt: skip
def test_what_does_not_run_on_the_clock_is_said(trace, fields, said):
    assert any(said in line for line in recording_lines(scenario(trace, **fields)))


def test_scenarios_without_a_clock_draw_as_before():
    plain = make_scenario("ieee33-weak", trace=(dated(),), split="test")
    undated = make_scenario("ieee33-weak", trace=(PowerTrace([0.0, 9000.0], [1.0, 1.0], "x"),), split="test")
    assert row_clocks(plain) is None
    assert recording_lines(plain) == recording_lines(undated) == []
    key = np.arange(4, dtype=np.uint64)
    assert len(np.unique(episode.draw(plain, key, 0 * key).start)) > 3


def test_generated_load_of_the_whole_is_that_of_test():
    whole, test = (make_scenario("ieee33-weak", split=split) for split in ("whole", "test"))
    np.testing.assert_array_equal(forecast(whole, 3).p_ref_kw, forecast(test, 3).p_ref_kw)
    assert scenario_hash(whole) != scenario_hash(test)
