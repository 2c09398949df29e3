"""Reading traces from text files, and the errors that name line and column."""

import gzip
import hashlib
import tracemalloc
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcgrid_env.traces import PowerTrace, TraceError
from dcgrid_env.traces.recording_file import read_file
from dcgrid_env.traces.text import text_file


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
        np.testing.assert_allclose(PowerTrace.from_csv(path, power_columns=columns, unit="W").power_kw, [0.2, 0.21])
    swapped = PowerTrace.from_csv(path, time_column="gpu0", power_columns=["time (s)"], unit="kW")
    np.testing.assert_array_equal(swapped.time_s, [100.0, 110.0])
    np.testing.assert_array_equal(swapped.power_kw, [0.0, 0.5])


def test_a_header_of_numbers_is_read_when_told(write):
    path = write("9,1,2\n0,100,200\n1,110,210\n")
    trace = PowerTrace.from_csv(path, header=True, power_columns=["2"], unit="W")
    np.testing.assert_allclose(trace.power_kw, [0.2, 0.21])


def test_other_delimiter(write):
    assert PowerTrace.from_csv(write("0;1\n1;2\n"), delimiter=";", unit="kW").power_kw.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("", {}, r"site.csv: is empty; give a file"),
        ("\n \n", {}, r"site.csv: is empty"),
        ("0,1\n", {}, r"site.csv: has 1 samples; give at least 2"),
        ("t,p_w\n", {}, r"site.csv: has 0 samples; give at least 2"),
        (TWO_GPUS, {"unit": "GW"}, r"unit 'GW' is unknown; choose one of W, kW, MW"),
        (TWO_GPUS, {"delimiter": "::"}, r"delimiter = '::' is not one character"),
        (TWO_GPUS, {"limit_kw": 0.0}, r"limit_kw = 0.0 is not a finite number above 0"),
        (
            TWO_GPUS,
            {"limit_kw": 0.21},
            r"line 3: column 2 is 220 W, above 0.21 kW, .*correct the unit, or raise limit_kw",
        ),
        (
            TWO_GPUS.replace("210", "3e9"),
            {},
            r"line 2: column 2 is 3e\+09 W, above 1e\+06 kW",
        ),
        (TWO_GPUS, {"gaps": "zero"}, r"gaps = 'zero' is unknown; choose one of error, hold, linear"),
        (TWO_GPUS, {"gaps": "linear"}, r"gaps = 'linear' needs max_gap_s"),
        (TWO_GPUS, {"max_gap_s": -1.0}, r"max_gap_s = -1.0 is not a finite number above 0"),
        (TWO_GPUS, {"max_gap_s": 1.0}, r"site.csv, line 3: comes 1.5 s after .* max_gap_s = 1; raise .* gaps='hold'"),
        (TWO_GPUS, {"max_gap_s": 1e-7, "gaps": "linear"}, r"line 3: .* more than 1000000 samples .*check the clock"),
        ("t,p [BTU]\n0,1\n1,1\n", {}, r"site.csv, line 1: 'p \[BTU\]' names the unit 'BTU', which is none of W"),
        ("t,p (hp)\n0,1\n1,1\n", {}, r"line 1: 'p \(hp\)' names the unit 'hp', which is none of"),
        ("t,P/kWh\n0,1\n1,1\n", {}, r"line 1: 'P/kWh' is energy, not power; name the columns of power with"),
        ("t,p_w (hp)\n0,1\n1,1\n", {}, r"line 1: 'p_w \(hp\)' names the unit 'hp', which is none of"),
        ("t,p [mw]\n0,1\n1,1\n", {}, r"line 1: 'p \[mw\]' may mean milliwatt or megawatt; pass unit='mW' or unit='MW'"),
        ("t,site_mw\n0,1\n1,1\n", {}, r"line 1: 'site_mw' may mean milliwatt or megawatt; pass unit='mW' or unit="),
        ("t,site_mw\n0,1\n1,1\n", {"unit": "W"}, r"line 1: 'site_mw' may mean"),
        ("t,p_mw [W]\n0,1\n1,1\n", {}, r"line 1: 'p_mw \[W\]' may mean"),
        ("t,p_w [kW]\n0,1\n1,1\n", {}, r"line 1: 'p_w \[kW\]' names the units W and kW; rename"),
        ("t,p_w\n0,1\n1,1\n", {"unit": "kW"}, r"line 1: 'p_w' names the unit W, but unit = 'kW' is given"),
        ("# a\ntime,power\n0,1\n1,1\n", {}, r"site.csv, line 2: 'power' names no unit of power; pass unit= \(one of W"),
        ("t,gpu[0]\n0,1\n1,1\n", {}, r"line 1: 'gpu\[0\]' names no unit of power"),
        ("t,p (left)\n0,1\n1,1\n", {}, r"line 1: 'p \(left\)' names no unit of power"),
        ("1,2\n0,1\n1,1\n", {"header": True}, r"line 1: '2' names no unit of power"),
        ("# a\nt,p [W]\n0,1\n1,1\n", {"unit": "kW"}, r"line 2: 'p \[W\]' names the unit W, but unit = 'kW' is given"),
        ("t,p [W],q\n0,1,1\n1,1,1\n", {}, r"line 1: 'q' names no unit of power; pass .*leave the column out"),
        ("# one\n# two\n", {}, r"site.csv: is empty"),
        ("# dcgrid trace {1\n0,1\n1,1\n", {}, r"site.csv, line 1: what follows .* is not JSON"),
        ("# dcgrid trace [1]\n0,1\n1,1\n", {}, r"site.csv, line 1: what follows .* is \[1\]; give a JSON object"),
        ('0,1\n1,"1\n2,1\n', {}, r"site.csv, line 2: a quoted cell does not end"),
        (TWO_GPUS, {"time_column": 3}, r"column 3 is unknown; columns are 0 to 2"),
        (TWO_GPUS, {"power_columns": [-1]}, r"column -1 is unknown"),
        (TWO_GPUS, {"power_columns": ["gpu0"]}, r"'gpu0' is asked for by name, but there is no header"),
        ("t,a,b\n0,1,2\n1,1,2\n", {"power_columns": ["c"]}, r"column 'c' is unknown; the header holds t, a, b"),
        ("t,a,a\n0,1,2\n1,1,2\n", {"power_columns": ["a"]}, r"column 'a' is not unique"),
        (TWO_GPUS, {"power_columns": [1, 1]}, r"a column stands twice"),
        (TWO_GPUS, {"power_columns": [0]}, r"a column stands twice"),
        (TWO_GPUS, {"power_columns": []}, r"power_columns is \[\]; give a list"),
        (TWO_GPUS, {"power_columns": "gpu0"}, r"power_columns is 'gpu0'; give a list"),
        ("0|1\n1|2\n", {"header": False}, r"has 1 column; give a time .*commas, semicolons or tabs"),
        ("0,1,2\n1,high,2\n", {}, r"site.csv, line 2: column 1 is 'high', not a number; repair or"),
        ("t,a\n0,1\n\n1,\n", {"unit": "W"}, r"site.csv, line 4: column 1 \('a'\) is '', not a number"),
        ("time,0,1\n0,1,2\n", {}, r"line 1: column 0 is 'time', not a number; .*if the line has the names"),
        ("0,1,2\n1,2\n", {}, r"site.csv, line 2: has 2 cells, the first line 3; repair the line"),
        ("0,1\n1,nan\n2,1\n", {}, r"site.csv, line 2: column 1 is nan; remove or repair"),
        ("0,1\ninf,1\n", {}, r"site.csv, line 2: column 0 is inf"),
        # One GPU below zero is named even where the sum is not.
        ("t,a,b\n0,9,9\n1,9,-2\n", {"unit": "W"}, r"site.csv, line 3: column 2 \('b'\) is -2; .*check the sign"),
        ("0,1\n2,1\n1,1\n", {}, r"site.csv, line 3: column 0 1.0 comes after 2.0; sort"),
        ("0,1\n2,1\n2,1\n", {}, r"site.csv, line 3: column 0 2.0 repeats 2.0"),
    ],
)
def test_bad_files_are_named(write, text, options, message):
    with pytest.raises(TraceError, match=message):
        PowerTrace.from_csv(write(text), **options)


def test_dates_in_other_forms_are_named(write):
    with pytest.raises(TraceError, match=r"line 2: column 0 \('Time'\) is '03/01/2026 12:00', .* like 2026-01-02T03"):
        PowerTrace.from_csv(write("Time,site kW\n03/01/2026 12:00,300\n03/01/2026 12:01,300\n"))


def test_a_file_that_is_not_text_is_named(tmp_path):
    path = tmp_path / "site.npy"
    np.save(path, np.full((3, 2), 0.1))
    with pytest.raises(TraceError, match=r"site.npy: is not a UTF-8 text file"):
        PowerTrace.from_csv(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"absent\.csv"):
        PowerTrace.from_csv(tmp_path / "absent.csv")


def test_units_are_told_by_the_header(write):
    path = write("time [s],a [W],b [kW],c (mW)\n0,100,2,3e6\n1,100,2,3e6\n")
    np.testing.assert_allclose(PowerTrace.from_csv(path).power_kw, [5.1, 5.1])
    np.testing.assert_allclose(PowerTrace.from_csv(path, power_columns=[2]).power_kw, [2.0, 2.0])
    assert PowerTrace.from_csv(write("t,p [Watts]\n0,9\n1,9\n")).power_kw == pytest.approx([0.009, 0.009])
    # What is no unit, or is overruled by the caller, does not count.
    for header in ("t,gpu[0]", "t,p (left)", "t,p"):
        trace = PowerTrace.from_csv(write(f"{header}\n0,9\n1,9\n"), unit="W")
        assert trace.power_kw == pytest.approx([0.009, 0.009])
    assert PowerTrace.from_csv(write("t,p [BTU]\n0,9\n1,9\n"), unit="kW").power_kw.tolist() == [9.0, 9.0]


@pytest.mark.parametrize(
    ("header", "kw"),
    [
        *[(name, 1e-3) for name in ("gpu0_w", "Power_W", "load W", "P/W", "W", "p in watts", "gpu_w[0]", "p_W (left)")],
        *[(name, 1.0) for name in ("site_kw", "site_kW", "POWER_KW", "P/kW", "P / kW", "power (kW)", "load kW", "kW")],
        *[(name, 1e3) for name in ("site_MW", "P/MW", "site (MW)", "p_megawatt", "power.MW", "p_mw [MW]")],
        *[(name, 1e-6) for name in ("gpu_mW", "gpu [mW]", "gpu milliwatts")],
    ],
)
def test_units_as_people_write_them(write, header, kw):
    assert PowerTrace.from_csv(write(f"t,{header}\n0,9\n1,9\n")).power_kw == pytest.approx([9 * kw, 9 * kw])


@pytest.mark.parametrize(("unit", "kw"), [("mW", 1e-6), ("MW", 1e3)])
def test_small_mw_is_told_by_the_caller(write, unit, kw):
    path = write("t,site_mw\n0,9\n1,9\n")
    assert PowerTrace.from_csv(path, unit=unit).power_kw == pytest.approx([9 * kw, 9 * kw])


@pytest.mark.parametrize(
    ("time", "step_s"),
    [
        ("t [ms]", 0.001),
        ("time_ms", 0.001),
        ("t(h)", 3600.0),
        ("t/\u00b5s", 1e-6),
        ("time_ns", 1e-9),
        ("Minutes", 60.0),
        ("days", 86400.0),
    ],
)
def test_time_columns_in_other_units(write, time, step_s):
    assert PowerTrace.from_csv(write(f"{time},p_w\n0,9\n1,9\n")).duration_s == pytest.approx(step_s)


@pytest.mark.parametrize(
    "time", ["time_s", "time", "t", "time [s]", "t (seconds)", "time/s", "Time_S", "timestamp", "s"]
)
def test_time_columns_in_seconds(write, time):
    assert PowerTrace.from_csv(write(f"{time},p_w\n0,9\n1,9\n")).duration_s == 1.0


COUNTER = "time_s,power_w,energy_j\n0,300,0\n1,400,350\n2,300,700\n"


def test_energy_is_not_summed_as_power(write):
    # A counter of J next to power: 300 W is right, 300 W + 350 J/s is not a power of anything.
    for columns, unit in ((None, None), (None, "W"), (["energy_j"], "W")):
        with pytest.raises(TraceError, match="line 1: 'energy_j' is energy, not power; name the columns of power"):
            PowerTrace.from_csv(write(COUNTER), power_columns=columns, unit=unit)
    assert PowerTrace.from_csv(write(COUNTER), power_columns=["power_w"]).power_kw.tolist() == [0.3, 0.4, 0.3]


@pytest.mark.parametrize("name", ["E [kWh]", "site_kWh", "E (J)", "gpuEnergy", "cpu_energy", "joules_total", "E/mJ"])
def test_names_of_energy(write, name):
    with pytest.raises(TraceError, match="is energy, not power"):
        PowerTrace.from_csv(write(f"t,{name}\n0,1\n1,2\n"), unit="kW")


@pytest.mark.parametrize("name", ["energy_rate_w", "memory_power", "joule street [kW]", "power 15 min mean (W)"])
def test_names_of_power_that_mention_other_quantities(write, name):
    unit = "W" if name == "memory_power" else None
    assert PowerTrace.from_csv(write(f"t,{name}\n0,1\n1,2\n"), unit=unit).duration_s == 1.0


@pytest.mark.parametrize("name", ["temp", "gpu temperature", "utilization.gpu", "fan_speed", "memory.used"])
def test_other_quantities_are_not_summed_as_power(write, name):
    path = write(f"t,power,{name}\n0,300,40\n1,300,41\n")
    with pytest.raises(TraceError, match="which is no power; name the columns of power with power_columns="):
        PowerTrace.from_csv(path, unit="W")
    assert PowerTrace.from_csv(path, unit="W", power_columns=["power"]).power_kw.tolist() == [0.3, 0.3]


@pytest.mark.parametrize("name", ["power_limit_w", "max_power [W]", "site rated kW", "powerCap_w", "Power Min (W)"])
def test_limits_and_extremes_are_not_summed_as_power(write, name):
    path = write(f"t,power_w,{name}\n0,300,700\n1,300,700\n")
    with pytest.raises(TraceError, match="which is no power; name the columns of power with power_columns="):
        PowerTrace.from_csv(path)
    assert PowerTrace.from_csv(path, power_columns=["power_w"]).power_kw.tolist() == [0.3, 0.3]
    assert PowerTrace.from_csv(path, power_columns=[name]).duration_s == 1.0


@pytest.mark.parametrize(
    "names", [("gpu0_w", "gpu1_w", "total_w"), ("Sum [W]", "A [W]"), ("power_average_w", "power_instant_w")]
)
@pytest.mark.parametrize("time", ["{}", "2026-03-01 12:00:0{}"])
def test_power_that_two_columns_contain_is_not_counted_twice(write, names, time):
    # 300 W each; a total of 600 W, and the mean of a power, are no further consumers.
    rows = "".join(f"{time.format(k)}{',300' * len(names)}\n" for k in range(3))
    path = write(f"t,{','.join(names)}\n{rows}")
    with pytest.raises(TraceError, match="; name the columns to sum with power_columns="):
        read_file(path)
    assert read_file(path, power_columns=names[:1]).power_kw.tolist() == [0.3] * 3


@pytest.mark.parametrize("names", [("rack 1 total_w", "rack 2 total_w"), ("gpu0_avg_w", "gpu1_avg_w")])
def test_sums_and_means_of_different_meters_are_summed(write, names):
    path = write(f"t,{','.join(names)}\n0,300,300\n1,300,300\n")
    assert PowerTrace.from_csv(path).power_kw.tolist() == [0.6, 0.6]


def test_the_column_of_times_is_found_by_its_name(write):
    path = write(",power,time_s\n0,300,0.0\n1,310,0.5\n")
    with pytest.raises(TraceError, match="line 1: column 0 has no name; name the columns of power with power_columns="):
        PowerTrace.from_csv(path, unit="W")
    trace = PowerTrace.from_csv(path, unit="W", power_columns=["power"])
    assert (trace.time_s.tolist(), trace.power_kw.tolist()) == ([0.0, 0.5], [0.3, 0.31])
    with pytest.raises(TraceError, match="'elapsed' names 'elapsed', which is no power"):
        PowerTrace.from_csv(write("time_s,elapsed,power\n0,0,1\n1,1,2\n"), unit="W")


def test_gaps_are_accepted_held_or_filled(write):
    path = write("0,10\n1,20\n2,10\n5,40\n6,10\n")
    held = PowerTrace.from_csv(path, unit="kW", max_gap_s=1.0, gaps="hold")
    np.testing.assert_array_equal(held.time_s, [0, 1, 2, 5, 6])
    filled = PowerTrace.from_csv(path, unit="kW", max_gap_s=1.0, gaps="linear")
    np.testing.assert_allclose(filled.time_s, [0, 1, 2, 3, 4, 5, 6])
    np.testing.assert_allclose(filled.power_kw, [10, 20, 10, 20, 30, 40, 10])


def test_first_lines_and_the_hash_go_to_the_provenance(write):
    text = '# dcgrid trace {"gpu": "A100", "period_s": 0.1}\n# made by hand\ntime,p_w\n0,1\n1,2\n'
    path = write(text)
    origin = PowerTrace.from_csv(path).provenance
    assert origin.parameters == {"gpu": "A100", "period_s": 0.1}
    assert origin.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert PowerTrace.from_csv(write("# dcgrid trace\n# dcgrid trace {}\n0,1\n1,2\n")).provenance.parameters == {}


def test_gzip_is_read_and_hashed_as_stored(tmp_path):
    path = tmp_path / "site.csv.gz"
    path.write_bytes(gzip.compress(TWO_GPUS.encode()))
    trace = PowerTrace.from_csv(path)
    np.testing.assert_allclose(trace.power_kw, [0.3, 0.32, 0.34])
    assert (trace.name, trace.provenance.name) == ("site", "site.csv.gz")
    assert trace.provenance.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize("damage", [lambda b: b[:-12], lambda b: b[:-8] + b"\0" * 8, lambda b: b + b"x"])
def test_a_damaged_gzip_is_named(tmp_path, damage):
    path = tmp_path / "site.csv.gz"
    path.write_bytes(damage(gzip.compress(TWO_GPUS.encode())))
    with pytest.raises(TraceError, match=r"site.csv.gz: cannot be unpacked .*fetch or compress it again"):
        PowerTrace.from_csv(path)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_encodings_and_line_ends(tmp_path, encoding, end):
    path = tmp_path / "site.csv"
    path.write_bytes(("t,p_w\n" + TWO_GPUS.replace(",2", "")).replace("\n", end).encode(encoding))
    assert PowerTrace.from_csv(path, power_columns=["p_w"]).time_s.tolist() == [0.0, 0.5, 2.0]


def test_lines_that_need_a_closer_look(write):
    # Blank lines, quotes, a name over two lines, text in columns that are not asked for.
    text = '"time\n(s)",gpu,"power"\n0,"a, b",1\n\n ,,\n1,c,"2"\n \n3,,1_0\n'
    trace = PowerTrace.from_csv(write(text), power_columns=["power"], unit="kW")
    assert trace.power_kw.tolist() == [1.0, 2.0, 10.0]
    with pytest.raises(TraceError, match=r"line 5: has 4 cells, the first line 3"):
        PowerTrace.from_csv(write("t,gpu,p_w\n0,a,1\n\n1,c,2\n2,b,c,2\n"), power_columns=["p_w"])


def test_a_line_without_end_is_named(write):
    with pytest.raises(TraceError, match=r"site.csv, line 2: is longer than 1048576 characters"):
        PowerTrace.from_csv(write("0,1\n" + "1" * (6 << 20)))


TABLES = st.lists(
    st.tuples(st.floats(1e-3, 1e3), st.lists(st.floats(0, 1e6), min_size=3, max_size=3)), min_size=2, max_size=30
)


@given(TABLES, st.sampled_from([1, 7, 64]), st.booleans(), st.sampled_from(["hold", "linear"]))
@pytest.mark.slow
def test_what_is_written_is_read_whatever_the_block(tmp_path_factory, table, block_chars, header, gaps):
    time_s = np.cumsum([step for step, _ in table])
    cells = np.array([row for _, row in table])
    lines = ["# note", "t,a_w,b (W),c [W]"] if header else []
    lines += [",".join(map(repr, row)) for row in np.column_stack([time_s, cells]).tolist()]
    path = tmp_path_factory.mktemp("tables") / "site.csv"
    path.write_text("\n\n".join(lines), encoding="utf-8")
    with mock.patch.object(text_file, "BLOCK_CHARS", block_chars):
        trace = PowerTrace.from_csv(path)
        filled = PowerTrace.from_csv(path, max_gap_s=100.0, gaps=gaps)
    np.testing.assert_array_equal(trace.time_s, time_s)
    np.testing.assert_allclose(trace.power_kw, cells.sum(axis=1) * 1e-3, rtol=1e-14, atol=1e-300)
    whole = PowerTrace.from_csv(path, max_gap_s=100.0, gaps=gaps)
    np.testing.assert_array_equal(filled.time_s, whole.time_s)
    np.testing.assert_array_equal(filled.power_kw, whole.power_kw)
    assert np.isin(time_s, filled.time_s).all()
    if gaps == "linear":
        assert np.diff(filled.time_s).max() <= 100.0 * (1 + 1e-9)
        at = np.interp(filled.time_s, time_s, trace.power_kw)
        np.testing.assert_allclose(filled.power_kw, at, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("block_chars", [1, 8, 1 << 22])
@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("4.5,1,nan", r"line 6: column 2 is nan"),
        ("4.5,1,-1", r"line 6: column 2 is -1"),
        ("4.5,1,x", r"line 6: column 2 is 'x'"),
        ("4,1,1", r"line 6: column 0 4.0 repeats 4.0"),
        ("3,1,1", r"line 6: column 0 3.0 comes after 4.0"),
        ("4.5,1", r"line 6: has 2 cells"),
        ("5,1e11,1", r"line 6: column 1 is 1e\+11"),
        ("7,1,1", r"line 6: comes 3 s after the sample before"),
    ],
)
def test_lines_are_named_whatever_the_block(write, block_chars, line, message):
    path = write(f"# note\n2,1,1\n3,1,1\n\n4,1,1\n{line}\n8,1,1\n")
    with mock.patch.object(text_file, "BLOCK_CHARS", block_chars), pytest.raises(TraceError, match=message):
        PowerTrace.from_csv(path, max_gap_s=2.5)


@pytest.mark.slow
def test_memory_is_bounded_by_what_is_kept(tmp_path):
    # 12 MB of 9 columns; 16 bytes a line are kept, and twice that while the trace takes its own copy.
    path, lines = tmp_path / "site.csv", 200_000
    with path.open("w", encoding="utf-8") as file:
        file.writelines(f"{i / 10:.9f},123.45,123.45,123.45,123.45,123.45,123.45,123.45,123.45\n" for i in range(lines))
    assert path.stat().st_size > 12e6
    with mock.patch.object(text_file, "BLOCK_CHARS", 1 << 16):
        tracemalloc.start()
        try:
            trace = PowerTrace.from_csv(path)
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
    assert len(trace.time_s) == lines
    assert peak < 50 * lines + 2e6


def test_shares_of_a_rating(write):
    for text, unit in (("time_s,site_share\n0,0.5\n1,1.0\n", None), ("0,0.5\n1,1.0\n", "share")):
        trace = PowerTrace.from_csv(write(text), unit=unit)
        assert (trace.power_kw.tolist(), trace.rated_kw) == ([0.5, 1.0], 1.0)


def test_the_rating_that_a_recorder_noted(write):
    assert PowerTrace.from_csv(write('# dcgrid trace {"rated_kw": 800}\ntime_s,kw\n0,1\n1,2\n')).rated_kw == 800.0
    assert PowerTrace.from_csv(write("time_s,kw\n0,1\n1,2\n")).rated_kw is None


DIRTY = "time_s,a_kw,b_kw\n0,1,1\n1,NaN,1\n2,,1\n3,-5,1\n4,2,2\n5,inf,1\n6,3,3\n"


def test_samples_without_a_valid_reading_are_dropped_on_request(write):
    trace = PowerTrace.from_csv(write(DIRTY), invalid="drop")
    assert trace.time_s.tolist() == [0.0, 4.0, 6.0]
    assert trace.power_kw.tolist() == [2.0, 4.0, 6.0]
    assert trace.provenance.parameters == {"dropped": {"not a number": 3, "negative": 1}}
    with mock.patch.object(text_file, "BLOCK_CHARS", 1):
        assert PowerTrace.from_csv(write(DIRTY), invalid="drop").provenance.parameters == trace.provenance.parameters
    with pytest.raises(TraceError, match=r"line 6: comes 4 s after .* max_gap_s = 3;"):
        PowerTrace.from_csv(write(DIRTY), invalid="drop", max_gap_s=3.0)


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        (DIRTY, {}, r"site.csv, line [34]: column 1 \('a_kw'\) is (nan; remove or repair|'', not a number; repair)"),
        (DIRTY + "7,x,1\n", {"invalid": "drop"}, r"line 9: column 1 \('a_kw'\) is 'x', not a number; repair or"),
        (DIRTY + "x,1,1\n", {"invalid": "drop"}, r"line 9: column 0 \('time_s'\) is 'x', not a number"),
        (DIRTY + "5,1,1\n", {"invalid": "drop"}, r"line 9: column 0 \('time_s'\) 5.0 comes after 6.0; sort the"),
        (DIRTY, {"invalid": "keep"}, r"invalid = 'keep' is unknown; choose one of error, drop"),
        ("t_s,a_share\n0,1\n1,90\n", {}, r"line 3: column 1 \('a_share'\) is 90, above 2 of the rating; .* per cent"),
        ("t_s,a_share,b_share\n0,1,1\n1,1,1\n", {}, r"line 1: has 2 columns of power, and shares .*; choose one with"),
        ("t_s,a_share\n0,1\n", {"unit": "kW"}, r"'a_share' is in share, but unit = 'kW' is given; leave unit out"),
        ("t_s,a_kw\n0,1\n", {"unit": "share"}, r"'a_kw' is in kW, but unit = 'share' is given; leave unit out"),
        ('# dcgrid trace {"rated_kw": "x"}\n0,1\n', {}, r"line 1: rated_kw is 'x'; give the rating of the site in kW"),
    ],
)
def test_shares_ratings_and_dropped_samples_are_checked(write, text, options, message):
    with pytest.raises(TraceError, match=message):
        PowerTrace.from_csv(write(text), **options)
