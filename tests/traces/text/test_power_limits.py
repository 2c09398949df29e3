"""One reading that no meter of its kind can have is refused in every format, with its place."""

import json

import numpy as np
import pytest

from dcgrid_env.traces import PowerTrace, TraceError, recorded_trace
from dcgrid_env.traces.recording_file import read_file
from dcgrid_env.traces.text.power_limits import limit_of, outlier

READINGS = [300 + k % 7 for k in range(200)]
SPIKED = [*READINGS[:100], 631_244.9, *READINGS[101:]]
"""W; the reading of index 100 is wrong."""


def dated(k):
    return f"2026-03-01 12:{k // 60:02d}:{k % 60:02d}"


def csv_of(header, line):
    return header + "\n" + "".join(line(k, w) + "\n" for k, w in enumerate(SPIKED))


def prometheus(labels):
    values = [[1772366400 + k, str(w)] for k, w in enumerate(SPIKED)]
    return json.dumps({"data": {"resultType": "matrix", "result": [{"metric": labels, "values": values}]}})


FILES = {
    "nvidia-smi": (csv_of("timestamp, power.draw [W]", lambda k, w: f"{dated(k)}.000, {w} W"), "line 102: "),
    "one GPU": (csv_of("time_s,gpu0_w,gpu1_w", lambda k, w: f"{k},{w},300"), r"line 102: column 1 \('gpu0_w'\)"),
    "no header": (csv_of("-1,300", lambda k, w: f"{k},{w}"), "line 102: column 1 is an outlier: 631.245 kW"),
    "site": (csv_of("time_s,site_w", lambda k, w: f"{k},{w}"), r"line 102: column 1 \('site_w'\) is an outlier"),
    "kW": (csv_of("time_s,site_kw", lambda k, w: f"{k},{w / 1000}"), "is an outlier: 631.245 kW, and the median"),
    "dated": (csv_of("time,n0_w,n1_w", lambda k, w: f"{dated(k)},{w},310"), "line 102: n0_w: power is an outlier"),
    "long": (csv_of("time,gpu,power_w", lambda k, w: f"{dated(k)},3,{w}"), "line 102: gpu 3 power_w: power is 631.2"),
    "dmon": (
        csv_of("#Entity POWER\nID W", lambda k, w: f"{dated(k).replace(' ', 'T')} GPU 0 {w}"), "line 103: GPU 0: POWER"
    ),
    "smi-dmon": (
        csv_of("# Date Time gpu pwr", lambda k, w: f"20260301 {dated(k)[11:]} 2 {w}"), "line 102: GPU 2: pwr is 631.2"
    ),
    "wattameter": (
        csv_of("# timestamp reading-time[ns] cpu-0[W]", lambda k, w: f"{dated(k).replace(' ', '_')} 9 {w}"),
        "line 102: cpu-0: power is 631.2",
    ),
    "DCGM": (prometheus({"__name__": "DCGM_FI_DEV_POWER_USAGE", "gpu": "0"}), "gpu=0, value 101: .*above 2 kW"),
    "nodes": (prometheus({"__name__": "node_watts", "instance": "n1"}), "instance=n1, value 101: .*is an outlier"),
}  # fmt: skip


@pytest.mark.parametrize("kind", FILES)
def test_one_wrong_reading_does_not_become_the_rating(tmp_path, kind):
    text, message = FILES[kind]
    path = tmp_path / "power.log"
    path.write_text(text)
    with pytest.raises(TraceError, match=message) as raised:
        recorded_trace(str(path))
    assert "repair or remove the reading" in str(raised.value)
    assert "limit_kw" in str(raised.value)
    assert read_file(path, limit_kw=632.0).power_kw.max() > 631.0


def test_one_wrong_reading_of_a_short_recording(tmp_path):
    path = tmp_path / "power.csv"
    path.write_text("time_s,site_w\n" + "".join(f"{k},{631_245 if k == 4 else 300}\n" for k in range(10)))
    with pytest.raises(TraceError, match=r"line 6: .* is an outlier: 631\.245 kW"):
        recorded_trace(str(path))


def test_recordings_of_sites_that_idle_are_no_outliers():
    idle = np.full(1000, 20.0)
    for busy in (5, 200):  # an idle site of 20 kW that draws 500 kW for 5 or 200 samples
        power_kw = idle.copy()
        power_kw[100 : 100 + busy] = 300.0
        assert outlier(power_kw) is None
    idle[10] = 500.0
    assert outlier(idle) == 10
    assert outlier(np.array([0.02] * 99 + [1.2])) is None  # a GPU that worked once


@pytest.mark.parametrize("name", ["GPU 3", "gpu0_w", "cpu-0", "uuid=GPU-1", "GPU-09cb2925-9d01", "card0", "gpu[12]"])
def test_names_of_one_device(name):
    assert limit_of(name, None) == 2.0
    assert limit_of(name, 5.0) == 5.0


@pytest.mark.parametrize(
    "name", ["site_kw", "gpus_kw", "all gpus [kW]", "gpu total", "gpu0-7_w", "rack 3", "n0_w", "sum(DCGM_FI_DEV_POWER)"]
)
def test_names_of_several_devices(name):
    assert limit_of(name, None) == 1e6


def test_a_sum_of_many_devices_is_accepted(tmp_path):
    path = tmp_path / "site.csv"
    path.write_text("time_s,gpus_kw\n" + "".join(f"{k},{40_000 + k}\n" for k in range(100)))
    assert PowerTrace.from_csv(path).power_kw.max() == 40_099.0
