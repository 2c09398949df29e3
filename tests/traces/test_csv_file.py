"""Reading traces from text files, and the errors that name line and column."""

import numpy as np
import pytest

from dcgrid_env.traces import PowerTrace, TraceError


@pytest.fixture
def write(tmp_path):
    def write_text(text, name="site.csv"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write_text


TWO_GPUS = "0,100,200\n0.5,110,210\n2,120,220\n"


def test_all_columns_but_the_time_are_summed(write):
    trace = PowerTrace.from_csv(write(TWO_GPUS))
    np.testing.assert_array_equal(trace.time_s, [0.0, 0.5, 2.0])
    np.testing.assert_allclose(trace.power_kw, [0.3, 0.32, 0.34])
    assert (trace.name, trace.provenance.name) == ("site", "site.csv")


@pytest.mark.parametrize(("unit", "factor"), [("W", 1e-3), ("kW", 1.0), ("MW", 1e3)])
def test_units(write, unit, factor):
    trace = PowerTrace.from_csv(write(TWO_GPUS), unit=unit)
    np.testing.assert_allclose(trace.power_kw, np.array([300.0, 320.0, 340.0]) * factor)


def test_columns_by_index_and_by_name(write):
    path = write("\ufefftime (s), gpu0 ,gpu1\n\n0,100,200\n0.5,110,210\n")
    for columns in ([2], ["gpu1"]):
        np.testing.assert_allclose(PowerTrace.from_csv(path, power_columns=columns).power_kw, [0.2, 0.21])
    swapped = PowerTrace.from_csv(path, time_column="gpu0", power_columns=["time (s)"], unit="kW")
    np.testing.assert_array_equal(swapped.time_s, [100.0, 110.0])
    np.testing.assert_array_equal(swapped.power_kw, [0.0, 0.5])


def test_a_header_of_numbers_is_read_when_told(write):
    path = write("9,1,2\n0,100,200\n1,110,210\n")
    np.testing.assert_allclose(PowerTrace.from_csv(path, header=True, power_columns=["2"]).power_kw, [0.2, 0.21])


def test_other_delimiter(write):
    assert PowerTrace.from_csv(write("0;1\n1;2\n"), delimiter=";", unit="kW").power_kw.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("", {}, r"site.csv: is empty; give a file"),
        ("\n \n", {}, r"site.csv: is empty"),
        ("0,1\n", {}, r"site.csv: has 1 samples; give at least 2"),
        ("t,p\n", {}, r"site.csv: has 0 samples; give at least 2"),
        (TWO_GPUS, {"unit": "GW"}, r"unit 'GW' is unknown; choose one of W, kW, MW"),
        (TWO_GPUS, {"time_column": 3}, r"column 3 is unknown; columns are 0 to 2"),
        (TWO_GPUS, {"power_columns": [-1]}, r"column -1 is unknown"),
        (TWO_GPUS, {"power_columns": ["gpu0"]}, r"'gpu0' is asked for by name, but there is no header"),
        ("t,a,b\n0,1,2\n1,1,2\n", {"power_columns": ["c"]}, r"column 'c' is unknown; the header holds t, a, b"),
        ("t,a,a\n0,1,2\n1,1,2\n", {"power_columns": ["a"]}, r"column 'a' is not unique"),
        (TWO_GPUS, {"power_columns": [1, 1]}, r"a column stands twice"),
        (TWO_GPUS, {"power_columns": [0]}, r"a column stands twice"),
        (TWO_GPUS, {"power_columns": []}, r"power_columns is \[\]; give a list"),
        (TWO_GPUS, {"power_columns": "gpu0"}, r"power_columns is 'gpu0'; give a list"),
        ("0;1\n1;2\n", {"header": False}, r"has 1 column; .*pass delimiter="),
        ("0,1,2\n1,high,2\n", {}, r"site.csv, line 2: column 1 is 'high', not a number; repair the cell"),
        ("t,a\n0,1\n\n1,\n", {}, r"site.csv, line 4: column 1 \('a'\) is '', not a number"),
        ("time,0,1\n0,1,2\n", {}, r"line 1: column 0 is 'time', not a number; pass header=True"),
        ("0,1,2\n1,2\n", {}, r"site.csv, line 2: has 2 cells, the first line 3; repair the line"),
        ("0,1\n1,nan\n2,1\n", {}, r"site.csv, line 2: column 1 is nan; remove or repair"),
        ("0,1\ninf,1\n", {}, r"site.csv, line 2: column 0 is inf"),
        # One GPU below zero is named even where the sum is not.
        ("t,a,b\n0,9,9\n1,9,-2\n", {}, r"site.csv, line 3: column 2 \('b'\) is -2; .*check the sign"),
        ("0,1\n2,1\n1,1\n", {}, r"site.csv, line 3: column 0 1.0 comes after 2.0; sort"),
        ("0,1\n2,1\n2,1\n", {}, r"site.csv, line 3: column 0 2.0 repeats 2.0"),
    ],
)
def test_bad_files_are_named(write, text, options, message):
    with pytest.raises(TraceError, match=message):
        PowerTrace.from_csv(write(text), **options)


def test_a_file_that_is_not_text_is_named(tmp_path):
    path = tmp_path / "site.npy"
    np.save(path, np.full((3, 2), 0.1))
    with pytest.raises(TraceError, match=r"site.npy: is not a UTF-8 text file"):
        PowerTrace.from_csv(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"absent\.csv"):
        PowerTrace.from_csv(tmp_path / "absent.csv")
