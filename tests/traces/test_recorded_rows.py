"""Rows from recordings made of requests: the compute-bound part and the requests come along."""

import numpy as np
import pytest

from dcgrid_env import PrefillDecodeDvfs, make_scenario
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.traces import (
    IDLE_SHARE,
    SPLITS,
    PowerTrace,
    Provenance,
    TraceError,
    from_recordings,
    replica,
    requests,
    serve,
)
from dcgrid_env.traces.boost import boosted_trace

SERVED = serve(requests("chat", hours=0.5, seed=1), replica("H100", "llama3-70b"), 2).trace


def test_rows_hold_the_compute_bound_part():
    rows = from_recordings([SERVED], "validation", 1.0)
    whole = SERVED.as_share()
    power, compute = whole.resample(1.0), whole.resample_compute(1.0)
    part = slice(round(0.6 * 1800), round(0.8 * 1800))
    np.testing.assert_array_equal(rows.p_share[0], power[part])
    assert rows.compute_share is not None
    assert compute is not None
    np.testing.assert_allclose(rows.compute_share[0] * (power[part] - IDLE_SHARE), compute[part], atol=1e-12)
    # A recording of power alone does not tell, and then nobody knows.
    assert from_recordings([SERVED, PowerTrace([0, 2000], [1, 1])], "train", 1.0).compute_share is None


def test_every_request_stands_in_the_row_it_arrives_in():
    assert SERVED.requests is not None
    counted = 0
    for split in SPLITS:
        rows = from_recordings([SERVED], split, 1.0)
        (row,) = rows.requests
        assert row.arrival_s.min() >= 0.0
        assert row.arrival_s.max() < rows.p_share.shape[1]
        assert (row.first_token_s >= row.prefill_s - 1e-9).all()
        counted += len(row.arrival_s)
    assert counted == len(SERVED.requests.arrival_s)
    # Rows that cover a part cut it again, each from its own beginning.
    short = PowerTrace(SERVED.time_s[:6001], SERVED.power_kw[:6001], "short", None, None, SERVED.requests)
    both = from_recordings([SERVED, short], "train", 1.0)
    assert both.p_share.shape == (4, 360)
    np.testing.assert_allclose(both.requests[0].arrival_s[0], SERVED.requests.arrival_s[0])
    begin = both.requests[2].arrival_s + 720.0
    inside = (SERVED.requests.arrival_s >= 720.0) & (SERVED.requests.arrival_s < 1080.0)
    np.testing.assert_allclose(begin, SERVED.requests.arrival_s[inside])


def test_a_recording_may_begin_at_any_time():
    assert SERVED.requests is not None
    later = SERVED.requests._replace(arrival_s=SERVED.requests.arrival_s + 4096.0)
    shifted = PowerTrace(
        SERVED.time_s + 4096.0, SERVED.power_kw, "later", None, SERVED.compute_kw, later, rated_kw=SERVED.rated_kw
    )
    for split in SPLITS:
        rows, wanted = (from_recordings([trace], split, 1.0) for trace in (shifted, SERVED))
        np.testing.assert_allclose(rows.p_share, wanted.p_share, atol=1e-9)
        for found, own in zip(rows.requests[0], wanted.requests[0], strict=True):
            np.testing.assert_allclose(found, own, atol=1e-9)


def test_the_environment_tells_their_delays():
    scenario = make_scenario(
        "ieee33-weak", trace=(SERVED,), datacenters={"clock_law": PrefillDecodeDvfs()}, split="test"
    )
    metrics = rollout(scenario, NoControl(), range(2)).metrics()[0]
    assert metrics["requests_sampled"] > 100
    assert metrics["delay_mean_s"] < 1e-9
    assert 0.0 < metrics["ttft_p50_s"] < metrics["ttft_p99_s"] < metrics["e2e_p99_s"]


def test_a_served_trace_keeps_its_rating():
    # Hardly any work: its peak is far below the rating.
    quiet = serve(requests("chat", 0.2, 1, rate_per_s=0.05), replica("H200", "llama3-70b"), 20).trace
    assert quiet.power_kw.max() < 0.3
    for split in SPLITS:
        rows = from_recordings([quiet], split, 1.0)
        assert rows.p_share.min() == pytest.approx(IDLE_SHARE, abs=1e-6)
        assert rows.p_share.max() < 0.3
    # Nor does a boost lift what does not follow the clock.
    assert from_recordings([quiet], "train", 1.0, boost_share=1.3).p_share.min() == pytest.approx(IDLE_SHARE, abs=1e-6)
    # In kW it is the same.
    site = PowerTrace(quiet.time_s, 280.0 * quiet.power_kw, "site", rated_kw=280.0)
    np.testing.assert_allclose(
        from_recordings([site], "test", 1.0).p_share, from_recordings([quiet], "test", 1.0).p_share, rtol=1e-12
    )


def test_known_compute_is_boosted_as_in_generated_traces():
    high = boosted_trace(SERVED, 1.3).resample(0.1)
    rows = from_recordings([SERVED], "train", 0.1, boost_share=1.3)
    np.testing.assert_array_equal(rows.p_share[0], high[: rows.p_share.shape[1]])
    assert 1.0 < rows.p_share.max() <= 1.3
    assert rows.compute_share is not None
    assert rows.compute_share.max() <= 1.0
    # Where the part is not known, the rating still is.
    plain = PowerTrace(SERVED.time_s, SERVED.power_kw, rated_kw=1.0)
    np.testing.assert_array_equal(
        from_recordings([plain], "train", 0.1, boost_share=1.3).p_share, from_recordings([plain], "train", 0.1).p_share
    )


def test_every_row_says_where_it_comes_from():
    short = PowerTrace(SERVED.time_s[:6001], SERVED.power_kw[:6001], "short", Provenance("short.csv"))
    rows = from_recordings([SERVED, short], "train", 1.0)
    assert [known.name for known in rows.provenance] == ["generator requests chat"] * 3 + ["short.csv"]
    traces = [PowerTrace([0, 60], [1, 1], provenance=Provenance(name)) for name in "abcd"]
    for split, names in (("train", ["a", "b"]), ("validation", ["c"]), ("test", ["d"])):
        rows = from_recordings(traces, split, 1.0, by="recording")
        assert [known.name for known in rows.provenance] == names


STEPS = np.array([0.2, 0.2, 0.9, 0.5, 0.4])
SHORT = PowerTrace(np.arange(6.0), [*STEPS, 0.4], "short", rated_kw=1.0)


def test_the_whole_of_a_recording_is_one_pool():
    trace = PowerTrace(np.arange(101.0), np.r_[np.arange(100.0), 99.0] / 100.0, "ramp", rated_kw=1.0)
    (row,) = from_recordings([trace], "whole", 1.0, 60.0).p_share
    np.testing.assert_allclose(row, np.arange(100.0) / 100.0)
    with pytest.raises(TraceError, match=r"test split has 20 s, but 60 s are needed; .* the split 'whole', which"):
        from_recordings([trace], "test", 1.0, 60.0)
    several = [trace.rated_at(kw) for kw in (1.0, 2.0, 4.0)]
    assert len(from_recordings(several, "whole", 1.0, 60.0, by="recording").p_share) == 3


def test_a_short_recording_is_repeated_without_a_jump():
    rows = from_recordings([SHORT], "whole", 1.0, 12.0)
    (row,) = rows.p_share
    np.testing.assert_allclose(row[:15], [*STEPS, *STEPS[::-1], *STEPS])
    assert len(row) == 5 + 12
    assert np.abs(np.diff(row)).max() == pytest.approx(np.abs(np.diff(STEPS)).max())
    assert rows.clocks == (None,)
    served = PowerTrace(SERVED.time_s, SERVED.power_kw, "served", None, SERVED.compute_kw, SERVED.requests, 1.0)
    twice = from_recordings([served], "whole", 1.0, 3600.0)
    assert twice.requests == ()
    assert twice.compute_share is not None
    assert twice.compute_share.shape == twice.p_share.shape


def test_rows_of_different_length_hold_their_last_value():
    long = PowerTrace(np.arange(11.0), np.full(11, 0.3), "long", rated_kw=1.0)
    rows = from_recordings([SHORT, long], "whole", 1.0, 4.0, full_rows=True)
    assert rows.row_steps == (5, 10)
    np.testing.assert_allclose(rows.p_share[0], [*STEPS, *[0.4] * 5])
