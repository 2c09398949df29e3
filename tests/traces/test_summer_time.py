"""Load profiles in local time: hours that clocks skip and repeat, with the changes of the IANA time zone database."""

from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np
import pytest

from dcgrid_env.traces import TraceError, read_profiles

SPRING_AND_AUTUMN = {
    "Europe/Berlin": ("2016-03-27", "2016-10-30"),  # SimBench's year
    "Europe/London": ("2025-03-30", "2025-10-26"),
    "Europe/Athens": ("2025-03-30", "2025-10-26"),
    "America/New_York": ("2024-03-10", "2024-11-03"),
    "America/Santiago": ("2024-09-08", "2024-04-07"),
    "Australia/Sydney": ("2023-10-01", "2024-04-07"),
}


def local_times(zone, first, n, step_s, begins=True):
    """Local times of evenly spaced samples from a local date on, at their beginnings or ends."""
    try:
        local = ZoneInfo(zone)
    except ZoneInfoNotFoundError:
        pytest.skip("the time zone database is not installed")
    start = datetime.fromisoformat(first).replace(tzinfo=local).astimezone(UTC)
    return [(start + timedelta(seconds=step_s * (k + (not begins)))).astimezone(local) for k in range(n)]


@pytest.mark.parametrize("zone", SPRING_AND_AUTUMN)
@pytest.mark.parametrize("step_s", [900, 3600])
@pytest.mark.parametrize("begins", [True, False])
def test_skipped_and_repeated_hours_leave_even_steps(zone, step_s, begins, tmp_path):
    path = tmp_path / "loads.csv"
    for day in SPRING_AND_AUTUMN[zone]:
        before = (datetime.fromisoformat(day) - timedelta(days=1)).date().isoformat()
        times = local_times(zone, before, 3 * 86400 // step_s, step_s, begins)
        naive = [f"{time:%d.%m.%Y %H:%M}" for time in times]
        for texts in (naive, [time.isoformat() for time in times]):
            path.write_text("time;a\n" + "".join(f"{time};{k}\n" for k, time in enumerate(texts)))
            table = read_profiles(path)
            assert (table.step_s, table.begin_h, table.first_day) == (step_s, 0.0 if begins else step_s / 3600, before)
            np.testing.assert_array_equal(table.values[:, 0], np.arange(len(times)))


@pytest.mark.slow
def test_a_whole_year_of_local_times_has_the_hours_of_a_year(tmp_path):
    path = tmp_path / "loads.csv"
    times = local_times("Europe/Berlin", "2016-01-01", 366 * 96, 900)
    assert times[-1].replace(tzinfo=None) == datetime(2016, 12, 31, 23, 45)
    path.write_text("time,a\n" + "".join(f"{time:%Y-%m-%dT%H:%M},{k}\n" for k, time in enumerate(times)))
    assert read_profiles(path).duration_h == 366 * 24


@pytest.mark.parametrize("by_load", [True, False])
def test_long_files_repeat_the_hour_for_each_load(by_load, tmp_path):
    times = [f"{time:%Y-%m-%dT%H:%M}" for time in local_times("Europe/Berlin", "2016-10-30", 20, 900)]
    cells = [(time, load, k) for k, time in enumerate(times) for load in "ab"]
    cells.sort(key=(lambda cell: cell[1]) if by_load else (lambda cell: cell[2]))
    path = tmp_path / "loads.csv"
    path.write_text("time,load,p\n" + "".join(f"{time},{load},{k}\n" for time, load, k in cells))
    table = read_profiles(path)
    np.testing.assert_array_equal(table.values, np.column_stack([np.arange(20)] * 2))


def samples(first, n, step_s=3600):
    """Times of evenly spaced samples without changes of the clock."""
    return [datetime.fromisoformat(first) + timedelta(seconds=step_s * k) for k in range(n)]


SATURDAY = samples("2016-03-26T00:00", 24)
YEAR = samples("2016-01-01T00:00", 366 * 24)
SKIPPED = datetime(2016, 3, 27, 2)


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ([t for t in SATURDAY if t.hour != 2], "7200 s after the sample before it"),
        ([t for t in samples("2016-03-27T00:00", 24) if t.hour != 12], "7200 s after the sample before it"),
        ([t for t in samples("2016-01-17T00:00", 24) if t.hour != 2], "7200 s after the sample before it"),
        ([*SATURDAY[:3], *SATURDAY[2:]], "repeats the time before it"),
        pytest.param(
            [t for t in YEAR if t != SKIPPED],
            "skips an hour there as clocks do, but repeats none in autumn",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            [t - timedelta(hours=t > datetime(2016, 10, 30, 2)) for t in YEAR],
            "repeats an hour there .* but skips none",
            marks=pytest.mark.slow,
        ),
    ],
)  # fmt: skip
def test_other_gaps_and_half_a_years_changes_are_refused(times, said, tmp_path):
    path = tmp_path / "loads.csv"
    path.write_text("time,a\n" + "".join(f"{time:%Y-%m-%dT%H:%M},1\n" for time in times))
    with pytest.raises(TraceError, match=rf"loads\.csv, line \d+, column 'time': .*({said})"):
        read_profiles(path)
