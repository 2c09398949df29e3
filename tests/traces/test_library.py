"""Rows that scenarios draw from: shape, splits, determinism, recordings cut in time or given out whole."""

import hashlib
import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from dcgrid_env.traces import (
    ALL_SPLITS,
    IDLE_SHARE,
    SERVICES,
    SPLITS,
    TRACE_SOURCES,
    PowerTrace,
    Site,
    Tenant,
    TraceError,
    from_recordings,
    library,
    requests,
    require_window,
    row_seed,
)
from dcgrid_env.traces.serving import site

# Made of requests; a seed is an hour of a day.
SERVED = ("chat", "code", "site", "llama3-70b", "llama3-405b", "mixtral-8x22b", "deepseek-v3")
DRAWN = [(source, split) for source in TRACE_SOURCES for split in ALL_SPLITS if (source, split) != ("step", "ood")]
HASHES = Path(__file__).parents[1] / "cases" / "trace_hashes.json"


@pytest.mark.parametrize(("source", "split"), DRAWN)
def test_shape_bounds_and_read_only(source, split):
    rows = library(source, split, 1.0, 150.0, count=5)
    assert rows.compute_share is not None
    for values in (rows.p_share, rows.compute_share):
        assert values.shape == (5, 150)
        assert values.dtype == np.float64
        assert values.min() >= 0.0
        assert values.max() <= 1.0
        with pytest.raises(ValueError, match="read-only"):
            values[0, 0] = 0.5
    assert len({known.seed for known in rows.provenance}) == 5
    assert library(source, split, 1, 150, 5).p_share is rows.p_share


@pytest.mark.parametrize(("source", "split"), DRAWN)
def test_requests_of_each_row(source, split):
    rows = library(source, split, 1.0, 150.0, count=5)
    assert len(rows.requests) == (5 if source in SERVED else 0)
    for times in rows.requests:
        assert np.isfinite(np.stack(times)).all()
        assert (np.diff(times.arrival_s) >= 0).all()
        assert times.arrival_s.min(initial=0.0) >= 0.0
        assert times.arrival_s.max(initial=0.0) < 150.0
        assert (times.prefill_s > 0).all()
        assert (times.first_token_s >= times.prefill_s - 1e-9).all()
        assert (times.end_s >= times.first_token_s).all()
    # A service that bursts may be silent in one row, but not in all.
    assert not rows.requests or sum(len(times.arrival_s) for times in rows.requests) > 50


def digest(*arrays):
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()


def test_the_bytes_are_those_of_every_platform():
    found = {}
    for source in TRACE_SOURCES:
        rows = library(source, "train", 1.0, 120.0, count=3)
        found[source] = digest(rows.p_share, rows.compute_share)
    for service in SERVICES:
        made = requests(service, hours=1, seed=0)
        found[f"requests {service}"] = digest(made.arrival_s, made.context_tokens, made.generated_tokens)
    known = json.loads(HASHES.read_text(encoding="utf-8"))
    wrong = sorted(name for name in found.keys() | known.keys() if found.get(name) != known.get(name))
    assert not wrong, (
        f"{', '.join(wrong)} differ from {HASHES.name}. If a generator was changed on purpose, say so in the changelog "
        f"and write there:\n{json.dumps(found, indent=2)}"
    )


@pytest.mark.parametrize("source", TRACE_SOURCES)
def test_splits_and_rows_share_no_window(source):
    # 0.1 s of two windows may agree by chance; ten seconds of idle ripple or work may not.
    splits = [split for split in ALL_SPLITS if (source, split) in DRAWN]
    rows = np.concatenate([library(source, split, 0.1, 60.0, count=6).p_share for split in splits])
    windows = [{row[k : k + 100].tobytes() for k in range(0, 100, 10)} for row in rows]
    for i, first in enumerate(windows):
        for second in windows[i + 1 :]:
            assert not first & second


def test_splits_share_no_seed():
    seeds = {split: {row_seed(split, row) for row in (0, 1, 23, 999_999)} for split in ALL_SPLITS}
    for lower, higher in pairwise(ALL_SPLITS):
        assert max(seeds[lower]) < min(seeds[higher])


@pytest.mark.parametrize("source", SERVED)
@pytest.mark.slow
def test_rows_made_of_requests_are_the_hours_of_days_of_their_own(source):
    hours = {}
    for split in ALL_SPLITS:
        rows = library(source, split, 1.0, 1.0)
        hours[split] = [known.parameters["hour"] for known in rows.provenance]
        assert sorted(hours[split]) == list(range(24))
    # Splits begin at hours of their own.
    assert len({known[0] for known in hours.values()}) > 1


def test_no_two_rows_have_the_same_day():
    # The demand of a site without hours, and of the same service.
    flat = Site("H100", 16, (Tenant("chat", "llama3-70b", 1.0, 0.2),), daily_swing=0.0)
    tenant = flat.tenants[0]
    rate = {
        site._Demand(flat, tenant, 0, row_seed(split, row), None, 0.0, 0.0).service.arrivals.rate_per_s
        for split in ALL_SPLITS
        for row in range(24)
    }
    assert len(rate) == 24 * len(ALL_SPLITS)
    assert 0.07 < np.std(np.log(list(rate))) < 0.13


@pytest.mark.parametrize("source", [source for source, split in DRAWN if split == "ood"])
def test_ood_is_drawn_from_the_shifted_generator(source):
    shifted = TRACE_SOURCES[source].shifted
    assert shifted is not None
    rows = library(source, "ood", 1.0, 60.0, 2)
    for row, p_share in enumerate(rows.p_share):
        np.testing.assert_array_equal(p_share, shifted(60.0, row_seed("ood", row)).resample(1.0))


def test_a_source_without_a_shifted_one_is_named():
    with pytest.raises(TraceError, match=r"'step' has no split 'ood'; choose one of train, validation, test"):
        library("step", "ood", 1.0, 60.0)
    with pytest.raises(TraceError, match=r"recordings have no split 'ood'; give recordings of another GPU or service"):
        from_recordings([ramp(100)], "ood", 1.0)


def test_the_first_rows_do_not_depend_on_the_count():
    few, many = (library("mixed", "test", 1.0, 90.0, count).p_share for count in (2, 4))
    np.testing.assert_array_equal(many[:2], few)


@pytest.mark.slow
def test_another_process_draws_the_same_bytes():
    code = (
        "import hashlib; from dcgrid_env.traces import library; "
        "print(hashlib.sha256(library('mixed', 'train', 1.0, 300.0, 6).p_share.tobytes()).hexdigest())"
    )
    there = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()
    assert there == hashlib.sha256(library("mixed", "train", 1.0, 300.0, 6).p_share.tobytes()).hexdigest()


@pytest.mark.parametrize("source", TRACE_SOURCES)
def test_a_coarser_step_holds_the_same_energy(source):
    fine, coarse = (library(source, "train", dt_s, 120.0, 3) for dt_s in (0.1, 1.0))
    np.testing.assert_allclose(fine.p_share.reshape(3, 120, 10).mean(axis=2), coarse.p_share, atol=1e-9)
    # So does the part that follows the clock.
    assert fine.compute_share is not None
    assert coarse.compute_share is not None
    work = [fine.compute_share * (fine.p_share - IDLE_SHARE), coarse.compute_share * (coarse.p_share - IDLE_SHARE)]
    np.testing.assert_allclose(work[0].reshape(3, 120, 10).mean(axis=2), work[1], atol=1e-9)


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
        (("solar", "train", 1.0, 60.0), r"no trace source 'solar'; `dcgrid list traces` lists all"),
        (("mixed", "exam", 1.0, 60.0), r"split 'exam' is unknown; choose one of train, validation, test, ood"),
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
    with pytest.raises(TraceError, match="by = 'day' is unknown; cut recordings by time or give them out by recording"):
        from_recordings([ramp(100)], "train", 1.0, by="day")
    with pytest.raises(TraceError, match=r"by='recording' needs at least 3 recordings, one a split, and got 2"):
        from_recordings([ramp(100), ramp(100)], "train", 1.0, by="recording")


@pytest.mark.parametrize(("n", "sizes"), [(3, (1, 1, 1)), (5, (3, 1, 1)), (10, (6, 2, 2)), (12, (8, 2, 2))])
def test_whole_recordings_go_to_the_splits_in_their_order(n, sizes):
    # Each has a peak of its own second, by which it is known again.
    traces = [PowerTrace(np.arange(31.0), 1.0 + (np.arange(31.0) == k), f"r{k}") for k in range(n)]
    parts = [from_recordings(traces, split, 1.0, by="recording").p_share for split in SPLITS]
    assert tuple(map(len, parts)) == sizes
    np.testing.assert_array_equal(np.concatenate(parts).argmax(axis=1), np.arange(n))
    assert all(part.shape[1] == 30 for part in parts)
    assert from_recordings(traces, "train", 1.0, by="recording").compute_share is None
    assert from_recordings(traces, "train", 1.0, by="recording").requests == ()


def test_a_whole_recording_that_is_too_short_is_named():
    traces = [ramp(100, name) for name in ("a", "b", "c")]
    assert from_recordings(traces, "test", 1.0, window_s=100.0, by="recording").p_share.shape == (1, 100)
    with pytest.raises(TraceError, match=r"'c' lasts 100 s, of which the test split has 100 s, but 101 s are needed"):
        from_recordings(traces, "test", 1.0, window_s=101.0, by="recording")
