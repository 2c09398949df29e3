"""Files of other meters: dcgmi dmon, WattAMeter, Prometheus, Redfish, IPMI collectors and the ML.ENERGY benchmark."""

import json

import numpy as np
import pytest

from dcgrid_env.traces import (
    PowerTrace,
    TraceError,
    read_dmon_log,
    read_gpu_log,
    read_power_json,
    read_stamped_csv,
    read_wattameter_log,
    recorded_trace,
)
from dcgrid_env.traces.text.dates import is_date, seconds

DMON = """\
#Entity   POWER    TMPTR
ID            W        C
GPU 0     100.5    40
GPU 1     200.0    41
GPU-I 3   50.0     41
GPU 0     110.5    40
GPU 1     N/A      41
#Entity   POWER    TMPTR
ID            W        C
GPU 0     120.5    40
GPU 1     220.0    41
"""
STAMPED_DMON = "".join(
    f"2026-01-02T03:04:{5 + second:02d}.000 {line}\n"
    for second, line in zip((0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2), DMON.splitlines(), strict=True)
)
WATTAMETER = """\
# timestamp                  reading-time[ns] gpu-0[mW] gpu-1[mW] gpu-0[C] gpu-1[C] cpu-0[W] cpu-0-core[W]
  2025-01-01_00:00:00.000000 12 100000 200000 40 41 90.0 30.0
  2025-01-01_00:00:00.100000 12 110000 210000 40 41 90.0 30.0
  2025-01-01_00:00:00.200000 12 120000 220000 40 41 90.0 30.0
"""
IPMI_LONG = """\
timestamp,node,sensor,power_w
2026-01-02T03:04:00Z,n1,psu,300
2026-01-02T03:04:01Z,n2,psu,400
2026-01-02T03:04:10Z,n1,psu,310
2026-01-02T03:04:11Z,n2,psu,N/A
2026-01-02T03:04:20Z,n1,psu,320
2026-01-02T03:04:21Z,n2,psu,420
"""
IPMI_WIDE = "time,n1_w,n2_w\n2026/01/02 03:04:00,300,400\n2026/01/02 03:04:10,310,410\n2026/01/02 03:04:20,320,420\n"


def series(labels, values, begin=1.7e9, step=15.0):
    name = {"__name__": "DCGM_FI_DEV_POWER_USAGE"}
    return {"metric": name | labels, "values": [[begin + i * step, str(v)] for i, v in enumerate(values)]}


def prometheus(*found):
    return {"status": "success", "data": {"resultType": "matrix", "result": list(found)}}


PROMETHEUS = prometheus(
    series({"UUID": "GPU-a", "pod": "x"}, [100, 110]),
    series({"UUID": "GPU-b"}, [200, "NaN", 220, 230]),
    series({"UUID": "GPU-a", "pod": "y"}, [120, 130], begin=1.7e9 + 30.0),
)
REPORTS = [
    {
        "@odata.type": "#MetricReport.v1_4_2.MetricReport",
        "MetricValues": [
            {"MetricId": "PowerConsumedWatts", "MetricProperty": f"/redfish/v1/Chassis/{node}/Power#/PowerControl/0/"
             "PowerConsumedWatts", "MetricValue": str(watt + 10 * minute), "Timestamp": f"2026-01-02T03:0{minute}:00Z"}
            for node, watt in (("1", 300), ("2", 400))
        ]
        + [{"MetricId": "InletTemp", "MetricValue": "25", "Timestamp": "2026-01-02T03:00:00Z"}],
    }
    for minute in range(3)
]  # fmt: skip
POLLED = [
    {"Timestamp": f"2026-01-02T03:04:0{2 * i}+00:00", "PowerControl": [
        {"MemberId": "0", "PowerConsumedWatts": 300 + 10 * i}, {"MemberId": "1", "PowerConsumedWatts": 400 + 10 * i},
    ]}
    for i in range(3)
]  # fmt: skip
ML_ENERGY = {
    "timeline": {
        "steady_state_start_time": 1.7e9,
        "power": {
            "device_instant": {"0": [[1.7e9, 100], [1.7e9 + 0.1, 110]], "1": [[1.7e9, 200], [1.7e9 + 0.1, 210]]},
            "device_average": {"0": [[1.7e9, 1], [1.7e9 + 0.1, 1]]},
        },
    }
}


@pytest.fixture
def write(tmp_path):
    def write_text(content, name="power.log"):
        path = tmp_path / name
        path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
        return path

    return write_text


def lines(objects):
    return "".join(json.dumps(item) + "\n" for item in objects)


@pytest.mark.parametrize(
    ("read", "content", "time_s", "watt"),
    [
        (read_dmon_log, STAMPED_DMON, [0, 1, 2], [300.5, 310.5, 340.5]),
        (read_wattameter_log, WATTAMETER, [0, 0.1, 0.2], [390, 410, 430]),
        (read_stamped_csv, IPMI_LONG, [0, 9, 19, 20], [700, 710, 720, 740]),
        (read_stamped_csv, IPMI_WIDE, [0, 10, 20], [700, 720, 740]),
        (read_power_json, PROMETHEUS, [0, 15, 30, 45], [300, 310, 340, 360]),
        (read_power_json, REPORTS, [0, 60, 120], [700, 720, 740]),
        (read_power_json, lines(POLLED), [0, 2, 4], [700, 720, 740]),
        (read_power_json, ML_ENERGY, [0, 0.1], [300, 320]),
    ],
)
def test_meters_are_summed_on_one_time_axis(read, content, time_s, watt, write):
    path = write(content)
    for trace in (read(path, gaps="hold"), recorded_trace(str(path))):
        np.testing.assert_allclose(trace.time_s, time_s, atol=1e-6)
        np.testing.assert_allclose(1e3 * trace.power_kw, watt)
        assert len(trace.provenance.sha256) == 64
        assert trace.provenance.parameters["began"].startswith("202")


def test_a_log_of_dmon_without_times_needs_its_delay(write):
    trace = read_dmon_log(write(DMON), step_s=0.5)
    assert trace.time_s.tolist() == [0.0, 0.5, 1.0]
    np.testing.assert_allclose(trace.power_kw, [0.3005, 0.3105, 0.3405])
    with pytest.raises(TraceError, match=r"power.log, line 3: begins with no time, .*or pass step_s="):
        read_dmon_log(write(DMON))


def test_a_log_that_was_cut_short_ends_before_its_last_line(write):
    assert read_dmon_log(write(STAMPED_DMON + "2026-01-02T03:04:07.000 GPU"), gaps="hold").duration_s == 2.0
    assert read_wattameter_log(write(WATTAMETER + "  2025-01-01_00:00:00.300000 12 1")).duration_s == pytest.approx(0.2)


def test_gaps_are_refused_held_or_filled(write):
    path = write("time,n1_w\n" + "".join(f"2026-01-02 03:{m:02d}:00,{m}\n" for m in (0, 1, 2, 3, 20)))
    with pytest.raises(TraceError, match=r"line 6: n1_w: comes 1020 s after .* max_gap_s = 300; .*gaps='hold'"):
        read_stamped_csv(path)
    assert len(read_stamped_csv(path, gaps="hold").time_s) == 5
    assert len(read_stamped_csv(path, gaps="linear").time_s) == 8


@pytest.mark.parametrize(
    ("read", "content", "message"),
    [
        (read_dmon_log, DMON.replace("POWER", "SMCLK"), r"line 1: the fields SMCLK, TMPTR lack POWER; log with `dcgmi"),
        (read_dmon_log, STAMPED_DMON.replace("100.5", "much"), r"line 3: POWER is 'much', not a number; repair"),
        (read_dmon_log, STAMPED_DMON.replace("100.5", "-1"), r"line 3: GPU 0: POWER is -0.001 kW, .*not negative"),
        (read_dmon_log, STAMPED_DMON.replace("100.5 ", "1 2 3"), r"line 3: .* is not a line of `dcgmi dmon` with 2"),
        (read_dmon_log, "", r"power.log: has no reading of POWER"),
        (read_dmon_log, STAMPED_DMON + STAMPED_DMON, r"line 14: GPU 0: comes 2 s before that of the reading above"),
        (read_wattameter_log, WATTAMETER.replace("mW", "C").replace("W]", "J]"), r"line 1: no column of .* is power"),
        (read_wattameter_log, "1 2 3\n", r"line 1: comes before the header"),
        (read_wattameter_log, WATTAMETER.replace("100000 2", "x 2"), r"line 2: gpu-0 is 'x', not a number"),
        (read_wattameter_log, WATTAMETER.replace("2025-01-01", "today"), r"line 2: the time is 'today_"),
        (read_stamped_csv, IPMI_LONG.replace("power_w", "power"), r"header: timestamp, .* names no unit of power"),
        (read_stamped_csv, IPMI_LONG.replace("310", "x"), r"line 4: column 'power_w' is 'x', not a number"),
        (read_stamped_csv, IPMI_LONG.replace("T03:04:10Z", " noon"), r"line 4: column 'timestamp': the time is"),
        (read_stamped_csv, "time,n1_w\nnoon,2\n", r"line 2: no cell is a date and time"),
        (read_stamped_csv, "time,n1_w\n", r"has no header with a reading below it"),
        (read_power_json, prometheus(), r"the query has no series"),
        (
            read_power_json,
            {"data": {"resultType": "vector", "result": []}},
            r"a query of type 'vector'; export a range",
        ),
        (
            read_power_json,
            prometheus(series({"__name__": "x_watts"}, [1]), series({}, [1])),
            r"choose one with metric=",
        ),
        (read_power_json, prometheus(series({"__name__": "x"}, [1, 2])), r"power.log: x names no unit; pass unit="),
        (read_power_json, prometheus(series({}, [1, 2]), series({}, [1, 2])), r"value 1: repeats the time"),
        (read_power_json, {"data": {"resultType": "matrix", "result": [{}]}}, r"has another form than expected"),
        (read_power_json, lines([{"PowerControl": []}] * 2), r"object 1 has no time; add a field Timestamp"),
        (read_power_json, prometheus(series({}, [1, 2], step=float("inf"))), r"value 1: the time is nan; repair or"),
        (read_power_json, {"a": 1}, r"has the fields a; export a range query of Prometheus"),
        (read_power_json, "[1, 2]", r"is not a JSON object, or a list of them"),
        (read_power_json, '{"a": 1,\n "b"', r"is not JSON \(.*line 2 "),
        (read_power_json, '{"a": 1}\n{"b"\n', r"line 2: is not JSON"),
    ],
)
def test_errors_name_the_place_and_the_remedy(read, content, message, write):
    with pytest.raises(TraceError, match=message) as raised:
        read(write(content))
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("read", [read_dmon_log, read_power_json, read_stamped_csv, read_wattameter_log])
def test_the_rule_for_gaps_is_checked(read, write):
    path = write({read_dmon_log: STAMPED_DMON, read_power_json: PROMETHEUS, read_stamped_csv: IPMI_WIDE,
                  read_wattameter_log: WATTAMETER}[read])  # fmt: skip
    with pytest.raises(TraceError, match="gaps = 'fill' is unknown; choose one of error, hold, linear"):
        read(path, gaps="fill")


def test_forms_of_time():
    assert seconds("1767323045.678", "") == 1767323045.678
    for text in ("2026-01-02T03:04:05Z", "2026-01-02 03:04:05", "2026/01/02 04:04:05+01:00", "2026-01-02_03:04:05"):
        assert seconds(text, "") == 1767323045.0
        assert is_date(text)
    assert not is_date("12.5")
    assert not is_date("n1")


def test_a_value_that_several_reports_repeat_is_one_reading(write):
    repeated = [*REPORTS, REPORTS[-1]]
    assert len(read_power_json(write(repeated)).time_s) == 3


def test_columns_of_other_quantities_identify_no_meter(write):
    # A temperature, a state and an index change from line to line; only the GPU identifies the meter.
    text = ",timestamp,gpu,power_w,temp,pstate,energy_j\n" + "".join(
        f"{2 * k + g},2026-01-02T03:04:{k:02d}Z,{g},{300 + g},{40 + k % 3},P{k % 2},{300 * k}\n"
        for k in range(20)
        for g in (0, 1)
    )
    trace = recorded_trace(str(write(text, "gpus.csv")))
    np.testing.assert_allclose(trace.power_kw, 0.601)
    assert trace.provenance.parameters["left_out"] == ["", "temp", "pstate", "energy_j"]


def test_a_date_and_a_time_in_two_columns_are_named(write):
    text = "Date,Time,kW\n" + "".join(f"2026-01-02,03:04:0{k},300\n" for k in range(3))
    with pytest.raises(TraceError, match="'Date' contains dates and 'Time' times; write both into one column, like 20"):
        read_stamped_csv(write(text))


def test_limits_of_a_gpu_are_no_readings(write):
    # Two GPUs draw 300 W and 301 W; each has a limit of 750 W.
    text = "timestamp,gpu,power_usage,max_power,hotspot\n" + "".join(
        f"{1772366400 + k},{g},{300 + g} W,750 W,55 C\n" for k in range(20) for g in (0, 1)
    )
    trace = read_stamped_csv(write(text, "amd-smi.csv"))
    np.testing.assert_allclose(trace.power_kw, 0.601)
    assert trace.provenance.parameters["left_out"] == ["max_power", "hotspot"]
    only = write("Time,Power Max (W)\n2026-01-02 03:04:00,2\n2026-01-02 03:04:01,3\n")
    with pytest.raises(TraceError, match=r"'Power Max \(W\)' names 'max'; pass power_columns= if it is power"):
        read_stamped_csv(only)
    assert read_stamped_csv(only, power_columns=["Power Max (W)"]).duration_s == 1.0


def test_numbers_without_a_unit_are_power_where_the_caller_says_so(write):
    text = "timestamp,gpu,power_usage,hotspot_temperature\n" + "".join(
        f"{1772366400 + k},{g},{'N/A' if k == 0 else 300 + g},40\n" for k in range(20) for g in (0, 1)
    )
    path = write(text, "amd-smi.csv")
    with pytest.raises(TraceError, match=r"names no unit of power; pass unit= .* and, if other columns"):
        read_stamped_csv(path)
    np.testing.assert_allclose(read_stamped_csv(path, unit="W").power_kw, 0.601)
    np.testing.assert_allclose(read_stamped_csv(path, unit="W", power_columns=["power_usage"]).power_kw, 0.601)


def test_cells_may_contain_the_unit(write):
    text = "Time,GPU 0,GPU 1\n" + "".join(
        f"2026-01-02 03:04:0{k},{'980 W' if k % 2 else '1.02 kW'},{'N/A' if k == 0 else '300 W'}\n" for k in range(5)
    )
    np.testing.assert_allclose(read_stamped_csv(write(text)).power_kw, [1.28, 1.32, 1.28, 1.32])
    with pytest.raises(TraceError, match=r"line 4: column 'GPU 1' is '300' without a unit, which the first cell has"):
        read_stamped_csv(write(text.replace("02,1.02 kW,300 W", "02,1.02 kW,300")))
    with pytest.raises(TraceError, match=r"line 2: column 'p \[W\]' is '2 kW', but the column is in W; repair"):
        read_stamped_csv(write("Time,p [W]\n2026-01-02 03:04:00,2 kW\n2026-01-02 03:04:01,3 W\n"))


ENERGY = "DCGM_FI_DEV_TOTAL_ENERGY_CONSUMPTION"


@pytest.mark.parametrize("unit", [None, "mW", "W"])
@pytest.mark.parametrize("name", [ENERGY, "node_rapl_package_joules_total", "energyWh"])
def test_counters_of_energy_are_refused(write, name, unit):
    counter = series({"__name__": name}, [0, 350_000, 700_000])
    with pytest.raises(TraceError, match=rf"metric: '{name}' is energy, not power; .*rate\({name}\[1m\]\)"):
        read_power_json(write(prometheus(counter)), unit=unit)
    text = "time,site_kwh\n2026-01-02 03:04:00,1\n2026-01-02 03:04:01,2\n"
    with pytest.raises(TraceError, match="header: 'site_kwh' is energy, not power; give a column of power"):
        read_stamped_csv(write(text), unit=unit)


@pytest.mark.parametrize("missing", ["[N/A]", "N/A", "n/a", "[Not Supported]", "[Unknown Error]", "ERR!", "nan", "NaN",
                                     "null", "None", "-", "--"])  # fmt: skip
def test_every_reader_has_the_same_texts_for_missing_readings(write, missing):
    cell = missing.replace("[Not Supported]", "[Not_Supported]").replace("[Unknown Error]", "[Unknown_Error]")
    texts = {
        read_dmon_log: STAMPED_DMON.replace("110.5", cell),
        read_wattameter_log: WATTAMETER.replace("110000", cell),
        read_stamped_csv: IPMI_WIDE.replace("310", missing),
        read_power_json: json.dumps(PROMETHEUS).replace('"110"', json.dumps(missing)),
        read_gpu_log: "timestamp, index, power.draw [W]\n"
        + "".join(
            f"2026/01/02 03:04:0{k}.000, {g}, {missing if k + g == 1 else 300}\n" for k in range(3) for g in (0, 1)
        ),
    }
    for read, text in texts.items():
        trace = read(write(text), gaps="hold")
        assert len(trace.time_s) >= 2, read
    path = write("time_s,kw\n0,1\n1,2\n" + f"2,{missing}\n3,4\n", "site.csv")
    assert PowerTrace.from_csv(path, invalid="drop").time_s.tolist() == [0.0, 1.0, 3.0]
    with pytest.raises(TraceError, match=r"line 4: .*pass invalid='drop'"):
        PowerTrace.from_csv(path)
