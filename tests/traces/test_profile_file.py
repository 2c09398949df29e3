"""Files of load profiles: all forms give the same table, and each fault is named with its place."""

from datetime import datetime, timedelta

import numpy as np
import pytest

from dcgrid_env.traces import ProfileTable, TraceError, read_classes, read_profiles, write_profiles

WIDE = "time,a,b,a.q\n2025-01-01T06:00,1,2,0.5\n2025-01-01T06:15,3,4,0.25\n2025-01-01T06:30,5,6,0.125\n"
LONG = (
    "time;load;p;q\n01.01.2025 06:00;a;1;0.5\n01.01.2025 06:00;b;2;0\n01.01.2025 06:15;a;3;0.25\n"
    "01.01.2025 06:15;b;4;0\n01.01.2025 06:30;a;5;0.125\n01.01.2025 06:30;b;6;0\n"
)
SIMBENCH = (
    "time;a_pload;b_pload;a_qload\n01.01.2025 06:00;1;2;0.5\n01.01.2025 06:15;3;4;0.25\n01.01.2025 06:30;5;6;0.125\n"
)
HOURS = "# a comment\ntime_h\ta\tb\ta.q\n6\t1\t2\t0.5\n6.25\t3\t4\t0.25\n6.5\t5\t6\t0.125\n"
OFFSETS = WIDE.replace(":00,", ":00+01:00,").replace("15,", "15+01:00,").replace("30,", "30+01:00,")


def columns(table):
    return dict(zip(table.names, table.values.T.tolist(), strict=True))


@pytest.mark.parametrize("text", [WIDE, LONG, SIMBENCH, HOURS, OFFSETS])
def test_every_form_gives_the_same_table(tmp_path, text):
    path = tmp_path / "loads.csv"
    path.write_text(text)
    table = read_profiles(path)
    found = columns(table)
    assert (table.begin_h, table.step_s, table.duration_h) == (6.0, 900.0, 0.75)
    assert [found[name] for name in ("a", "b", "a.q")] == [[1, 3, 5], [2, 4, 6], [0.5, 0.25, 0.125]]
    assert table.first_day == ("" if "time_h" in text else "2025-01-01")
    write_profiles(table, tmp_path / "again.csv", ["a comment"])
    again = read_profiles(tmp_path / "again.csv")
    assert (columns(again), again.begin_h, again.step_s) == (found, 6.0, 900.0)
    assert (again.first_day, again.utc_offset_h) == (table.first_day, table.utc_offset_h)
    assert table.utc_offset_h == (1.0 if text == OFFSETS else None)


def test_parquet(tmp_path, monkeypatch):
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    first = datetime(2025, 1, 1, 6)
    times = [first + timedelta(minutes=15 * k) for k in range(3)]
    path = tmp_path / "loads.parquet"
    parquet.write_table(pyarrow.table({"time": times, "a": [1.0, 3.0, 5.0], "b": [2, 4, 6]}), path)
    assert columns(read_profiles(path)) == {"a": [1, 3, 5], "b": [2, 4, 6]}
    parquet.write_table(pyarrow.table({"time": times, "a": [1.0, None, 5.0]}), path)
    with pytest.raises(TraceError, match="row 2, column 'a': the value is None; give a finite number"):
        read_profiles(path)
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(TraceError, match=r"needs pyarrow, which is missing; .*\[parquet\]"):
        read_profiles(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (WIDE.replace("3,4", "3,x"), "line 3, column 'b': the value is 'x'; give a finite number"),
        (WIDE.replace("3,4", "nan,4"), "line 3, column 'a': the value is 'nan'; give a finite number"),
        (WIDE.replace("3,4", ",4"), "line 3, column 'a': the value is ''; give a finite number"),
        (
            WIDE.replace("3,4", "3,-1e300"),
            "line 3, column 'b': the value is '-1e300'; no feeder has more than 1e.08; check",
        ),
        (WIDE.replace("06:15", "06:00"), "line 3, column 'time': it repeats the time before it; sort the samples"),
        (WIDE.replace("06:15", "05:45"), "line 3, column 'time': it is before the time of the sample before it; sort"),
        (WIDE + "2025-01-01T07:00,1,1,1\n", "line 5, column 'time': 1800 s after the sample before it, and the others"),
        (WIDE.replace("06:15", "6 o'clock"), "line 3, column 'time': the time is .* write it like"),
        (WIDE.replace("3,4,", "3,"), "line 3: it has 3 cells, and the header 4; give a value for each column"),
        (WIDE.replace("time,a,b", "when,a,b"), "the first column is 'when'; give the times in time, time_s, time_h"),
        (WIDE.replace("time,a,b", "time,a,a"), "the column 'a' is there twice; give each column one name"),
        (WIDE.replace("T06:15", "T06:15Z"), "line 3, column 'time': .* give a UTC offset to all times or to none"),
        (HOURS.replace("6.25", "6.00001").replace("6.5\t", "6.00002\t"), "the samples are 0.036 s apart; give 1 s to"),
        ("time,a\n2025-01-01T06:00,1\n", "it has 1 samples; give at least 2"),
        (LONG.replace("01.01.2025 06:15;b;4;0\n", ""), "line 4, column 'load': 'b' has no sample at 01.01.2025 06:15"),
        (
            LONG.replace("06:30;b", "06:15;b"),
            "line 7, column 'time': 'b' has a second sample at 01.01.2025 06:15; sort",
        ),
        (LONG.replace(";p;q", ";kw;q"), "the columns of the long form are time, load, kw, q; give time, load, p"),
        ("", "it has no header or no samples"),
    ],
)
def test_a_fault_is_named_with_its_place(tmp_path, text, said):
    path = tmp_path / "loads.csv"
    path.write_text(text)
    with pytest.raises(TraceError, match=rf"loads\.csv.*{said}"):
        read_profiles(path)


def test_values_between_samples_and_after_the_end():
    table = ProfileTable(6.0, 3600.0, ("a",), np.array([[1.0], [3.0], [7.0]]))
    hours = np.array([6.0, 6.5, 7.0 - 1e-12, 8.75, 9.25])

    def at(**how):
        return table.values_at(hours, **how)[:, 0].tolist()

    assert at(linear=False, repeat=False) == [1, 1, 3, 7, 7]  # a rounding error before 7 h counts as 7 h
    assert at(linear=True, repeat=False) == [1, 2, 3, 7, 7]
    assert at(linear=False, repeat=True) == [1, 1, 3, 7, 1]
    assert at(linear=True, repeat=True) == [1, 2, 3, 2.5, 1.5]  # 8.75 h: 7 + 0.75 (1 - 7)


def test_classes(tmp_path):
    path = tmp_path / "Load.csv"
    path.write_text("id;node;profile;pLoad\nL1;n1;H0-A;0.1\nL2;n2;G1-B;0.2\n")
    assert read_classes(path) == {"n1": "H0-A", "n2": "G1-B"}
    path.write_text("load,class\na,x\na,y\n")
    with pytest.raises(TraceError, match="line 3, column 'load': 'a' has a second class 'y'; give one"):
        read_classes(path)
