"""Rows that scenarios draw from: shape, splits, determinism, recordings cut in time."""

import hashlib
import subprocess
import sys

import numpy as np
import pytest

from dcgrid_env.traces import (
    SPLITS,
    TRACE_SOURCES,
    PowerTrace,
    TraceError,
    from_recordings,
    library,
    require_window,
    row_seed,
)


@pytest.mark.parametrize("source", TRACE_SOURCES)
@pytest.mark.parametrize("split", SPLITS)
def test_shape_bounds_and_read_only(source, split):
    rows = library(source, split, 1.0, 150.0, count=5).p_share
    assert rows.shape == (5, 150)
    assert rows.dtype == np.float64
    assert rows.min() >= 0.0
    assert rows.max() <= 1.0
    assert library(source, split, 1, 150, 5).p_share is rows
    with pytest.raises(ValueError, match="read-only"):
        rows[0, 0] = 0.5


def test_sources_describe_themselves():
    assert list(TRACE_SOURCES) == ["inference", "training", "mixed", "step"]
    for name, source in TRACE_SOURCES.items():
        assert source.name == name
        assert source.description
        assert "\n" not in source.description


@pytest.mark.parametrize("source", TRACE_SOURCES)
def test_splits_and_rows_share_no_window(source):
    # 0.1 s of two windows may agree by chance; ten seconds of idle ripple or work may not.
    rows = np.concatenate([library(source, split, 0.1, 60.0, count=6).p_share for split in SPLITS])
    windows = [{row[k : k + 100].tobytes() for k in range(0, 100, 10)} for row in rows]
    for i, first in enumerate(windows):
        for second in windows[i + 1 :]:
            assert not first & second


def test_splits_share_no_seed():
    seeds = {split: {row_seed(split, row) for row in (0, 1, 23, 999_999)} for split in SPLITS}
    assert not seeds["train"] & seeds["validation"]
    assert not seeds["train"] & seeds["test"]
    assert not seeds["validation"] & seeds["test"]
    assert max(seeds["train"]) < min(seeds["validation"]) <= max(seeds["validation"]) < min(seeds["test"])


def test_the_first_rows_do_not_depend_on_the_count():
    few, many = (library("mixed", "test", 1.0, 90.0, count).p_share for count in (2, 4))
    np.testing.assert_array_equal(many[:2], few)


def test_another_process_draws_the_same_bytes():
    code = (
        "import hashlib; from dcgrid_env.traces import library; "
        "print(hashlib.sha256(library('mixed', 'train', 1.0, 300.0, 6).p_share.tobytes()).hexdigest())"
    )
    there = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()
    assert there == hashlib.sha256(library("mixed", "train", 1.0, 300.0, 6).p_share.tobytes()).hexdigest()


def test_a_coarser_step_is_the_mean_of_the_finer():
    fine, coarse = (library("training", "train", dt_s, 120.0, 3).p_share for dt_s in (0.1, 2.0))
    np.testing.assert_allclose(fine.reshape(3, 60, 20).mean(axis=2), coarse, atol=1e-9)


def test_steps_that_do_not_divide_the_duration():
    assert library("inference", "train", 0.7, 100.0, 1).p_share.shape == (1, 142)
    assert library("inference", "train", 0.25, 0.26, 1).p_share.shape == (1, 1)


def test_toy_step_row_is_the_papers_experiment():
    rows = library("step", "train", 1.0, 100.0).p_share
    assert rows.shape == (24, 100)
    assert (rows[:, :20] <= 0.23).all()
    assert (rows[:, 20:] == 1.0).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("solar", "train", 1.0, 60.0), r"source 'solar' is unknown; choose one of inference, training, mixed, step"),
        (("mixed", "exam", 1.0, 60.0), r"split 'exam' is unknown; choose one of train, validation, test"),
        (("mixed", "train", 0.0, 60.0), r"dt_s = 0.0 is not a finite number above 0"),
        (("mixed", "train", -1.0, 60.0), r"dt_s = -1.0"),
        (("mixed", "train", float("nan"), 60.0), r"dt_s = nan"),
        (("mixed", "train", 0.05, 60.0), r"dt_s = 0.05 is below the 0.1 s .* choose dt_s >= 0.1 or supply recordings"),
        (("mixed", "train", 1.0, 0.0), r"duration_s = 0.0"),
        (("mixed", "train", 1.0, 0.5), r"duration_s = 0.5 is shorter than one step of 1 s"),
        (("mixed", "train", 1.0, 60.0, 0), r"count = 0 is not in 1 to 1000000"),
        (("step", "train", 1.0, 15.0), r"step_s = 20.0 does not lie within the trace of 15 s"),
    ],
)
def test_bad_requests_are_named(arguments, message):
    with pytest.raises(TraceError, match=message):
        library(*arguments)


def test_a_window_longer_than_the_rows_is_named():
    rows = library("inference", "train", 0.5, 60.0, 2)
    require_window(rows, 120, 0.5, "inference")
    with pytest.raises(TraceError, match=r"'inference' lasts 60 s but the episode needs 60.5 s \(121 steps of 0.5 s\)"):
        require_window(rows, 121, 0.5, "inference")


def ramp(duration_s, name="ramp", scale_kw=3.0):
    # Every second has a level of its own, so that a shared second would show.
    return PowerTrace(np.arange(duration_s + 1.0), scale_kw * np.arange(1.0, duration_s + 2.0), name)


def test_recordings_are_cut_into_disjoint_parts():
    trace = ramp(100)
    parts = {split: from_recordings([trace], split, 1.0).p_share for split in SPLITS}
    assert [parts[split].shape for split in SPLITS] == [(1, 60), (1, 20), (1, 20)]
    np.testing.assert_allclose(
        np.concatenate([parts[split][0] for split in SPLITS]), np.arange(1.0, 101.0) / 101.0, atol=1e-12
    )


def test_a_longer_recording_gives_several_rows_that_cover_it():
    rows = from_recordings([ramp(50, "short"), ramp(125, "long", 7.0)], "train", 1.0).p_share
    assert rows.shape == (4, 30)
    assert rows.max() <= 1.0
    np.testing.assert_allclose(np.unique(rows[1:]), np.arange(1.0, 76.0) / 126.0)
    with pytest.raises(ValueError, match="read-only"):
        rows[0, 0] = 0.5


def test_recordings_that_do_not_serve_are_named():
    with pytest.raises(TraceError, match="got no trace"):
        from_recordings([], "train", 1.0)
    with pytest.raises(TraceError, match="split 'all' is unknown"):
        from_recordings([ramp(100)], "all", 1.0)
    with pytest.raises(TraceError, match="dt_s = 0"):
        from_recordings([ramp(100)], "train", 0)
    with pytest.raises(TraceError, match="window_s = -1"):
        from_recordings([ramp(100)], "train", 1.0, window_s=-1)
    with pytest.raises(
        TraceError, match=r"'b' lasts 100 s, of which the test split has 20 s, but 30 s are needed; .* 150 s"
    ):
        from_recordings([ramp(200, "a"), ramp(100, "b")], "test", 1.0, window_s=30.0)
    with pytest.raises(TraceError, match="'dark': power_kw is 0"):
        from_recordings([PowerTrace([0, 9], [0, 0], "dark")], "train", 1.0)
