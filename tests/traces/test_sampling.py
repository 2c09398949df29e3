"""Sampling and rounds of several meters, by hand."""

import json

import numpy as np
import pytest

from dcgrid_env import make_scenario, scenario_hash
from dcgrid_env.traces import PowerTrace, TraceError, read_gpu_log, read_stamped_csv, recorded_trace
from dcgrid_env.traces.logs.meters import held_total
from dcgrid_env.traces.recording_check import check_recording
from dcgrid_env.traces.recording_file import columns_line
from dcgrid_env.traces.sampling import sampling_of

SECONDS = np.arange(600.0)


def smi(offsets_s, interval_s=1.0, n=300, skip=()):
    """A log of nvidia-smi whose GPUs report `offsets_s` after the begin of a round, 100 W times their number."""
    lines = ["timestamp, index, power.draw [W]"]
    for k in range(n):
        for gpu, offset_s in enumerate(offsets_s):
            if (gpu, k) not in skip:
                at = np.datetime64("2026-03-01T12:00:00.000") + np.timedelta64(
                    round(1e3 * (k * interval_s + offset_s)), "ms"
                )
                lines.append(f"{str(at).replace('-', '/').replace('T', ' ')}, {gpu}, {100 * (gpu + 1) + k % 2} W")
    return "\n".join(lines) + "\n"


@pytest.fixture
def log(tmp_path):
    def write(text, name="gpu.log"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


def report(trace):
    return check_recording(trace, 1.0, 20.0, 0.0)


@pytest.mark.parametrize("apart_s", [0.0, 0.003, 0.04])
def test_gpus_that_report_together_are_one_round(log, apart_s):
    trace = read_gpu_log(log(smi(apart_s * np.arange(8))))
    np.testing.assert_allclose(trace.time_s, np.arange(300.0), atol=1e-9)
    np.testing.assert_allclose(trace.power_kw, 3.6 + 0.008 * (np.arange(300) % 2))
    found = report(trace)
    assert (found.meters, found.interval_s, found.gaps, found.gap_share) == (8, pytest.approx(1.0), 0, 0.0)
    assert "sampling: every 1 s of each of 8 meters, jitter 0.000 s (95 %)" in found.lines()
    assert not any("in gaps" in line for line in found.warnings())


def test_a_missing_reading_holds_and_keeps_the_round(log):
    trace = read_gpu_log(log(smi([0.0, 0.003], skip={(0, 5), (1, 9)})))
    np.testing.assert_allclose(trace.power_kw[4:7], [0.3, 0.301, 0.3])  # GPU 0 stays at 100 W
    np.testing.assert_allclose(trace.time_s[[4, 6, 9]], [4.0, 6.0, 9.0])


def test_meters_that_report_by_turns_keep_their_times(log):
    trace = read_gpu_log(log(smi([0.0, 2.5, 5.0, 7.5], 10.0, 60)))
    found = report(trace)
    assert (found.interval_s, found.gaps) == (10.0, 0)
    np.testing.assert_allclose(np.diff(trace.time_s), 2.5)


def test_the_meter_with_the_gap_is_named(log):
    skip = {(1, k) for k in range(100, 110)}
    found = report(read_gpu_log(log(smi([0.0, 0.003, 0.006], skip=skip))))
    assert (found.gaps, found.longest_gap_s) == (1, pytest.approx(11.0))
    assert found.gap_share == pytest.approx(11.0 / 299.0)
    assert any("1, the longest 11 s" in line and "(GPU 1)" in line for line in found.lines())


def test_meters_that_begin_late_or_end_early_are_named(log):
    text = "time,node,power_w\n" + "".join(
        f"2026-03-01 12:{k // 60:02d}:{k % 60:02d},{node},{100}\n"
        for k in range(300)
        for node, begin, end in (("a", 0, 300), ("b", 120, 300), ("c", 0, 200))
        if begin <= k < end
    )
    path = log(text, "nodes.csv")
    with pytest.raises(TraceError, match="line 481: node c power_w: its last reading is 100 s from the end"):
        read_stamped_csv(path)
    trace = read_stamped_csv(path, gaps="hold")
    assert trace.provenance.parameters["starts_late_s"] == {"node b power_w": 120.0}
    assert trace.provenance.parameters["ends_early_s"] == {"node c power_w": 100.0}
    assert "starts_late_s [node b power_w by 120], ends_early_s [node c power_w by 100]" in columns_line(path, trace)
    assert (trace.began, trace.duration_s) == ("2026-03-01T12:02:00.000", 179.0)


def test_series_of_prometheus_with_offsets_are_rounds(log):
    series = [
        {"metric": {"__name__": "x_watts", "node": f"n{i}"}, "values": [[1.7724e9 + 15 * k + 0.02 * i, str(100 + i)]
         for k in range(100)]}
        for i in range(16)
    ]  # fmt: skip
    trace = recorded_trace(str(log(json.dumps({"data": {"resultType": "matrix", "result": series}}), "p.json")))
    assert len(trace.time_s) == 100
    np.testing.assert_allclose(trace.power_kw, sum(0.1 + 0.001 * i for i in range(16)))


def test_a_rating_keeps_the_sampling(log):
    trace = read_gpu_log(log(smi([0.0, 0.003]))).with_site_rating(5.0)
    assert trace.sampling.meters == 2


def test_the_sampling_identifies_no_trace(log):
    trace = read_gpu_log(log(smi([0.0, 0.003])))
    plain = PowerTrace(trace.time_s, trace.power_kw, trace.name, trace.provenance)
    hashes = {scenario_hash(make_scenario("toy6", trace=(made,))) for made in (trace, plain)}
    assert len(hashes) == 1


def test_energy_of_rounds_is_that_of_the_meters():
    rng = np.random.default_rng(0)
    series = {f"GPU {i}": (SECONDS + 0.01 * i, rng.uniform(0.1, 0.7, 600)) for i in range(8)}
    found = held_total(series)
    energy = np.sum(found.power_kw[:-1] * np.diff(found.time_s))
    # Each reading holds for a second; those of the last round only mark the end.
    np.testing.assert_allclose(energy, sum(kw[:-1].sum() for _, kw in series.values()))


def test_sampling_of_meters_with_other_intervals():
    found = sampling_of({"a": np.arange(0.0, 100.0), "b": np.arange(0.0, 100.0, 10.0), "c": np.arange(0.0, 100.0)})
    assert (found.interval_s, found.gaps, found.meter) == (1.0, 0, "")


def test_a_counter_of_energy_without_a_name_is_reported():
    rises = report(PowerTrace(SECONDS, 0.35 * SECONDS + 1.0))
    assert any("counter of energy" in line for line in rises.warnings())
    assert not any("counter of energy" in line for line in report(PowerTrace(SECONDS, 1.0 + SECONDS % 60)).warnings())


def test_a_peak_that_was_measured_once_is_reported():
    power_kw = 0.3 + 0.1 * (SECONDS % 60 > 30)
    power_kw[77] = 1.9  # below the limit of a GPU
    warnings = report(PowerTrace(SECONDS, power_kw)).warnings()
    assert any("the peak of 1.9 kW stands for the rating, but the power exceeds 0.4 kW for 0.5%" in w for w in warnings)
