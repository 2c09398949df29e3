"""Rows from recordings made of requests: the compute-bound part and the requests come along."""

import numpy as np

from dcgrid_env import PhaseDvfs, make_scenario
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.traces import IDLE_SHARE, SPLITS, PowerTrace, from_recordings, replica, requests, serve

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


def test_the_environment_tells_their_delays():
    scenario = make_scenario("ieee33-weak", trace=(SERVED,), dvfs=PhaseDvfs(), split="test")
    metrics = rollout(scenario, NoControl(), range(2)).metrics()[0]
    assert metrics["requests"] > 100
    assert metrics["delay_mean_s"] < 1e-9
    assert 0.0 < metrics["ttft_p50_s"] < metrics["ttft_p99_s"] < metrics["e2e_p99_s"]
