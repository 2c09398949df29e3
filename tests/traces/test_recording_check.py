"""What the check of a recording finds."""

import json

import numpy as np
import pytest

from dcgrid_env.traces import PowerTrace, TraceError
from dcgrid_env.traces.recording_check import check_recording

SECONDS = np.arange(1001.0)
SAW = 100.0 + 0.5 * (SECONDS % 100)


def check(time_s=SECONDS, power_kw=SAW, rated_kw=None, dt_s=1.0, needed_s=20.0):
    return check_recording(PowerTrace(time_s, power_kw, "hall", rated_kw=rated_kw), dt_s, needed_s, 0.2)


def test_levels_ramps_and_windows_of_a_clean_recording():
    report = check(rated_kw=200.0)
    assert (report.samples, report.duration_s, report.interval_s, report.jitter_s) == (1001, 1000.0, 1.0, 0.0)
    assert (report.gaps, report.constant, report.zero_share, report.below_idle_share) == (0, (), 0.0, 0.0)
    assert report.idle_kw == 102.0  # 5 of 100 s are at 100 to 102 kW
    assert (report.peak_kw, report.peak_share) == (149.5, 0.7475)
    assert report.ramps_kw[0] == 0.5
    assert report.ramps_kw[-1] == 49.5
    assert report.windows == {"train": 30, "validation": 10, "test": 10}
    assert report.warnings() == []


def test_gaps_and_jitter():
    time_s = SECONDS + np.where(SECONDS % 2 == 1, 0.1, 0.0) + np.where(SECONDS >= 500, 40.0, 0.0)
    report = check(time_s)
    assert (report.gaps, report.longest_gap_s) == (1, pytest.approx(40.9))
    assert report.interval_s == pytest.approx(1.0, abs=0.11)
    assert 0.0 < report.jitter_s < 0.21
    assert report.gap_share == pytest.approx(40.9 / 1040.0)
    assert any("% of the time is in gaps" in line for line in report.warnings())


def test_constant_and_zero_stretches_are_named():
    power_kw = SAW.copy()
    power_kw[200:320], power_kw[500:600] = 0.0, 130.0
    report = check(power_kw=power_kw)
    assert [(s.begin_s, s.duration_s, s.level_kw) for s in report.constant] == [
        (200.0, 120.0, 0.0),
        (500.0, 100.0, 130.0),
    ]
    assert report.zero_share == pytest.approx(0.12)
    assert any("power is 0 at times" in line for line in report.warnings())


@pytest.mark.parametrize(
    ("options", "warning"),
    [
        ({}, "the rating is unknown, so the peak stands for it; pass --rated-kw"),
        ({"rated_kw": 100.0}, "the peak of 149.5 kW exceeds the rating of 100 kW; correct --rated-kw"),
        ({"power_kw": SAW / 200.0, "rated_kw": 1.0}, "the power is in shares of a rating; pass --rated-kw"),
        ({"rated_kw": 1000.0}, "100.0% of the time is below the site's idle power"),
        ({"needed_s": 300.0}, "validation, test are too short for an episode of 300 s; record at least 1500 s"),
        ({"needed_s": 100.0}, "few independent windows in validation, test"),
        ({"dt_s": 0.5}, "samples are 1 s apart, the environment's step is 0.5 s; ramps faster"),
    ],
)
def test_warnings_name_the_remedy(options, warning):
    assert any(warning in line for line in check(**options).warnings())


def test_a_logger_that_waits_its_interval_after_each_sample_misses_no_ramp():
    # nvidia-smi -l 1 samples every 1.005 s.
    assert not [line for line in check(time_s=1.005 * np.arange(len(SAW))).warnings() if "apart" in line]
    assert [line for line in check(time_s=1.5 * np.arange(len(SAW))).warnings() if "apart" in line]


def test_shares_are_printed_without_kilowatts_and_all_findings_are_json():
    report = check(power_kw=SAW / 200.0, rated_kw=1.0)
    text = "\n".join(report.lines())
    assert "power: idle 51.0%, mean 62.4%, peak 74.8%; shares of the rating" in text
    assert "kW" not in text
    assert json.loads(json.dumps(report.record()))["windows"] == {"train": 30, "validation": 10, "test": 10}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"power_kw": 0.0 * SAW}, "trace 'hall': draws no power in 1001 samples; check the power columns"),
        ({"dt_s": 600.0}, "trace 'hall' lasts 1000 s but 1200 s are needed"),
        ({"needed_s": 0.0}, "needed_s = 0.0 is not a finite number above 0"),
    ],
)
def test_what_cannot_be_described_is_refused(options, message):
    with pytest.raises(TraceError, match=message):
        check(**options)


@pytest.mark.parametrize("rated_kw", [None, 200.0, 1.0])
def test_a_written_trace_is_read_back_exactly(tmp_path, rated_kw):
    trace = PowerTrace(SECONDS / 3, SAW / (200.0 if rated_kw == 1.0 else 1.0), "hall", rated_kw=rated_kw)
    trace.to_csv(tmp_path / "hall.csv")
    again = PowerTrace.from_csv(tmp_path / "hall.csv")
    np.testing.assert_array_equal(again.time_s, trace.time_s)
    np.testing.assert_array_equal(again.power_kw, trace.power_kw)
    assert again.rated_kw == rated_kw


def test_a_site_rating_turns_shares_into_kilowatts_and_leaves_kilowatts():
    shares = PowerTrace(SECONDS, SAW / 200.0, "hall", compute_kw=SAW / 400.0, rated_kw=1.0).with_site_rating(800.0)
    np.testing.assert_allclose(shares.power_kw, 4 * SAW)
    assert shares.compute_kw is not None
    np.testing.assert_allclose(shares.compute_kw, 2 * SAW)
    assert shares.rated_kw == 800.0
    assert PowerTrace(SECONDS, SAW).with_site_rating(800.0).power_kw.max() == SAW.max()
    with pytest.raises(TraceError, match="rating_kw = 0 is not a finite number above 0"):
        PowerTrace(SECONDS, SAW).with_site_rating(0)
