"""Units of times that are numbers; right values are Python's own dates."""

import json
from datetime import UTC, datetime

import numpy as np
import pytest

from dcgrid_env.traces import TraceError, recorded_trace

BEGIN_S = int(datetime(2026, 3, 1, 12, tzinfo=UTC).timestamp())
PER_S = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}


@pytest.mark.parametrize("unit", PER_S)
@pytest.mark.parametrize("name", ["timestamp", "Time", "time_{}", "t [{}]"])
def test_times_since_1970_in_any_unit(tmp_path, unit, name):
    path = tmp_path / "site.csv"
    rows = "".join(f"{(BEGIN_S + k) * PER_S[unit]},{300 + k}\n" for k in range(900))
    path.write_text(f"{name.format(unit)},power_w\n{rows}")
    trace = recorded_trace(str(path))
    assert trace.duration_s == 899.0
    np.testing.assert_allclose(np.diff(trace.time_s), 1.0)
    assert trace.began == "2026-03-01T12:00:00.000"


@pytest.mark.parametrize("unit", PER_S)
def test_prometheus_and_long_tables_in_any_unit(tmp_path, unit):
    times = [(BEGIN_S + k) * PER_S[unit] for k in range(60)]
    series = {"metric": {"__name__": "x_watts"}, "values": [[t, "300"] for t in times]}
    path = tmp_path / "power.json"
    path.write_text(json.dumps({"data": {"resultType": "matrix", "result": [series]}}))
    assert recorded_trace(str(path)).duration_s == 59.0
    path = tmp_path / "power.csv"
    path.write_text("timestamp,gpu,power_w,temp\n" + "".join(f"{t},{g},300,40\n" for t in times for g in (0, 1)))
    trace = recorded_trace(str(path))
    assert (trace.duration_s, trace.began) == (59.0, "2026-03-01T12:00:00.000")
    np.testing.assert_allclose(trace.power_kw, 0.6)
    assert trace.provenance.parameters["left_out"] == ["temp"]


@pytest.mark.parametrize(
    ("header", "times", "message"),
    [
        ("time_ms", [BEGIN_S, BEGIN_S + 1], r"line 2: .*is in s since 1970, but the name 'time_ms' says ms; correct"),
        ("time_s", [BEGIN_S * 1000, BEGIN_S * 1000 + 1000], r"is in ms since 1970, but the name 'time_s' says s"),
        ("time", [0, BEGIN_S * 1000], r"line 3: column 0 \('time'\): the time 1772366400000 is too large for s since"),
        ("time", [0, BEGIN_S], r"line 3: .* is too large for s since the beginning"),
        ("time", [BEGIN_S, BEGIN_S * 1000], r"line 3: .* is too large for s since 1970; give all times in one unit"),
        ("time", [638 * 10**15, 638 * 10**15 + 10**7], r"line 2: .* is too large for s since the beginning"),
    ],
)
def test_times_whose_unit_is_in_doubt(tmp_path, header, times, message):
    path = tmp_path / "site.csv"
    path.write_text(f"{header},site_kw\n" + "".join(f"{t},1\n" for t in times))
    with pytest.raises(TraceError, match=message):
        recorded_trace(str(path))


def test_the_date_is_kept_when_a_trace_is_saved(tmp_path):
    path, saved = tmp_path / "site.csv", tmp_path / "saved.csv"
    path.write_text("time,site_kw\n" + "".join(f"2026-03-01T13:00:0{k}+01:00,{k}\n" for k in range(5)))
    recorded_trace(str(path)).to_csv(saved)
    assert recorded_trace(str(saved)).began == "2026-03-01T12:00:00.000"
