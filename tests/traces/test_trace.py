"""PowerTrace: checks, scaling, and the exact averages of held samples."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from dcgrid_env.traces import PowerTrace, Provenance, RequestTimes, TraceError


def hand_trace():
    # 10 kW for 1.5 s, 20 kW for 1 s, 0 kW for 2.5 s; the last sample marks the end at 5 s.
    return PowerTrace([0.0, 1.5, 2.5, 5.0], [10.0, 20.0, 0.0, 99.0], name="hand")


def test_resample_worked_by_hand():
    trace = hand_trace()
    assert trace.duration_s == 5.0
    assert trace.energy_kws == 35.0
    np.testing.assert_allclose(trace.resample(1.0), [10.0, 15.0, 10.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(trace.resample(2.5), [14.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(trace.resample(5.0), [7.0], atol=1e-12)


def test_resample_drops_what_is_left_after_the_last_whole_step():
    np.testing.assert_allclose(hand_trace().resample(2.0), [12.5, 5.0], atol=1e-12)


def test_resample_counts_from_the_first_sample():
    shifted = PowerTrace(hand_trace().time_s + 1.7e9, hand_trace().power_kw)
    np.testing.assert_allclose(shifted.resample(1.0), hand_trace().resample(1.0), atol=1e-12)


def test_resample_of_a_sample_within_one_step():
    # A spike of 0.1 s inside a step of 1 s counts with a tenth.
    trace = PowerTrace([0.0, 0.4, 0.5, 2.0], [0.0, 100.0, 0.0, 0.0])
    np.testing.assert_allclose(trace.resample(1.0), [10.0, 0.0], atol=1e-12)


def test_resample_back_onto_its_own_grid_is_exact():
    # 0.1 k is not what repeated addition gives; rounding must neither lose a step nor mix in a neighbour.
    power_kw = np.arange(1001.0) % 7
    trace = PowerTrace(np.cumsum(np.full(1001, 0.1)), power_kw)
    assert np.abs(trace.resample(0.1) - power_kw[:-1]).max() < 1e-6
    assert len(trace.resample(0.3)) == 333


def test_resample_of_a_constant_is_that_constant_exactly():
    trace = PowerTrace([0.0, 0.3, 0.7, 1.9, 100.0], np.full(5, 0.1))
    assert (trace.resample(0.7) == 0.1).all()


held_samples = st.lists(
    st.tuples(st.floats(1e-3, 10.0), st.floats(0.0, 1e4, allow_subnormal=False)), min_size=2, max_size=40
)


@given(samples=held_samples, steps=st.integers(1, 50), start_s=st.floats(-1e4, 1e4))
def test_resample_keeps_energy_and_bounds(samples, steps, start_s):
    time_s = start_s + np.cumsum([gap for gap, _ in samples])
    trace = PowerTrace(time_s, [power for _, power in samples])
    dt_s = trace.duration_s / steps
    mean_kw = trace.resample(dt_s)
    assert mean_kw.shape == (steps,)
    assert mean_kw.sum() * dt_s == pytest.approx(trace.energy_kws, rel=1e-9, abs=1e-9)
    assert mean_kw.min() >= trace.power_kw[:-1].min()
    assert mean_kw.max() <= trace.power_kw[:-1].max()


@given(samples=held_samples, dt_s=st.floats(0.05, 3.0))
@pytest.mark.slow
def test_resample_equals_a_direct_sum_over_pieces(samples, dt_s):
    trace = PowerTrace(np.cumsum([gap for gap, _ in samples]), [power for _, power in samples])
    assume(abs(trace.duration_s - dt_s) > 1e-6)  # a step that is missing by rounding alone is let pass
    if trace.duration_s < dt_s:
        with pytest.raises(TraceError, match="are needed"):
            trace.resample(dt_s)
        return
    start_s = trace.time_s[0]
    for k, mean_kw in enumerate(trace.resample(dt_s)):
        low_s, high_s = start_s + k * dt_s, start_s + (k + 1) * dt_s
        overlap_s = np.minimum(trace.time_s[1:], high_s) - np.maximum(trace.time_s[:-1], low_s)
        direct_kw = float(np.sum(overlap_s.clip(0) * trace.power_kw[:-1])) / dt_s
        assert mean_kw == pytest.approx(direct_kw, rel=1e-6, abs=1e-4)


def test_scaling():
    scaled = hand_trace().scaled_to(500.0)
    assert scaled.power_kw.max() == 500.0
    np.testing.assert_allclose(scaled.power_kw, np.array([10.0, 20.0, 0.0, 99.0]) * 500.0 / 99.0)
    assert scaled.name == "hand"
    assert scaled.rated_kw == 500.0
    assert hand_trace().as_share().power_kw.max() == 1.0
    assert hand_trace().as_share().rated_kw == 1.0


def test_a_share_is_that_of_the_rating_where_it_is_known():
    base = worked_trace()
    trace = PowerTrace(base.time_s, base.power_kw, "rated", None, base.compute_kw, rated_kw=200.0)
    share = trace.as_share()
    np.testing.assert_allclose(share.power_kw, [0.05, 0.1, 0.0, 0.495])
    assert share.compute_kw is not None
    np.testing.assert_allclose(share.compute_kw, [0.02, 0.1, 0.0, 0.25])
    assert share.rated_kw == 1.0
    assert share.as_share().power_kw.tobytes() == share.power_kw.tobytes()
    # A trace of nothing but zeros has a share of a rating, though not of its peak.
    assert PowerTrace([0, 1], [0, 0], rated_kw=5.0).as_share().power_kw.tolist() == [0.0, 0.0]
    # Scaling makes the peak the rating, whatever the rating was.
    assert trace.scaled_to(99.0).as_share().power_kw.max() == 1.0


@pytest.mark.parametrize("rated_kw", [0.0, -1.0, np.nan, np.inf])
def test_a_bad_rating_is_named(rated_kw):
    with pytest.raises(TraceError, match=r"trace 'bad': rated_kw = .* not a finite number above 0; give the rating"):
        PowerTrace([0, 1], [1, 1], "bad", rated_kw=rated_kw)


def test_arrays_are_read_only_copies():
    power_kw = np.array([1.0, 2.0])
    trace = PowerTrace([0, 1], power_kw)
    power_kw[0] = 7.0
    assert trace.power_kw[0] == 1.0
    assert trace.time_s.dtype == np.float64
    for values in (trace.time_s, trace.power_kw):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 3.0


@pytest.mark.parametrize(
    ("time_s", "power_kw", "message"),
    [
        ([0, 1, 2], [1, np.nan, 1], r"'bad': index 1: power_kw is nan; remove or repair"),
        ([0, 1, 2], [1, 1, np.inf], r"'bad': index 2: power_kw is inf"),
        ([0, np.nan, 2], [1, 1, 1], r"'bad': index 1: time_s is nan"),
        ([0, 1, 2], [1, -4, 1], r"'bad': index 1: power_kw is -4; .*check the sign"),
        ([0, 2, 1], [1, 1, 1], r"'bad': index 2: time_s 1.0 comes after 2.0; sort"),
        ([0, 1, 1], [1, 1, 1], r"'bad': index 2: time_s 1.0 repeats 1.0"),
        ([0], [1], r"'bad': time_s has shape \(1,\); give at least 2 samples"),
        ([], [], r"'bad': time_s has shape \(0,\); give at least 2 samples"),
        ([0, 1], [[1, 1], [1, 1]], r"'bad': power_kw has shape \(2, 2\)"),
        ([0, 1, 2], [1, 1], r"'bad': time_s has 3 samples, power_kw 2"),
        ([0, 1], ["a", "b"], r"'bad': power_kw is not a list of numbers"),
    ],
)
def test_bad_samples_are_named(time_s, power_kw, message):
    with pytest.raises(TraceError, match=message):
        PowerTrace(time_s, power_kw, name="bad")


@pytest.mark.parametrize("dt_s", [0.0, -1.0, np.nan, np.inf])
def test_bad_step_is_named(dt_s):
    with pytest.raises(TraceError, match=r"dt_s = .* not a finite number above 0; give a step"):
        hand_trace().resample(dt_s)


def test_too_short_is_named():
    assert hand_trace().require_duration(5.0).name == "hand"
    for ask in (hand_trace().require_duration, hand_trace().resample):
        with pytest.raises(TraceError, match=r"'hand' lasts 5 s but 5.1 s are needed; give a longer trace"):
            ask(5.1)
    with pytest.raises(TraceError, match="needed_s = 0"):
        hand_trace().require_duration(0)


def test_bad_scaling_is_named():
    with pytest.raises(TraceError, match=r"'dark': power_kw is 0 in all 2 samples and cannot be scaled to 5 kW"):
        PowerTrace([0, 1], [0, 0], name="dark").scaled_to(5.0)
    for rating_kw in (0.0, -1.0, np.nan):
        with pytest.raises(TraceError, match="rating_kw"):
            hand_trace().scaled_to(rating_kw)


def worked_trace():
    # As by hand, of which 4, 20 and 0 kW follow the clock.
    times = RequestTimes(np.array([0.5]), np.array([0.1]), np.array([2.0]), np.array([0.05]))
    base = hand_trace()
    return PowerTrace(base.time_s, base.power_kw, "worked", Provenance("x", seed=1), [4.0, 20.0, 0.0, 50.0], times)


def test_a_trace_may_know_its_compute_and_requests():
    trace = worked_trace()
    assert trace.compute_kw is not None
    means_kw = trace.resample_compute(1.0)
    assert means_kw is not None
    np.testing.assert_allclose(means_kw, [4.0, 12.0, 10.0, 0.0, 0.0], atol=1e-12)
    assert trace.requests is not None
    assert trace.requests.end_s.tolist() == [2.0]
    assert trace.requests.prefill_s.tolist() == [0.05]
    assert str(trace.provenance) == "x, seed 1"
    with pytest.raises(ValueError, match="read-only"):
        trace.compute_kw[0] = 3.0


def test_scaling_keeps_what_a_trace_knows():
    trace, scaled = worked_trace(), worked_trace().scaled_to(500.0)
    assert scaled.compute_kw is not None
    np.testing.assert_allclose(scaled.compute_kw, np.array([4.0, 20.0, 0.0, 50.0]) * 500.0 / 99.0)
    assert scaled.compute_kw.max() <= scaled.power_kw.max()
    assert scaled.requests is not None
    assert scaled.requests.arrival_s.tolist() == [0.5]
    assert scaled.provenance == trace.provenance


def test_other_traces_do_not_know_them():
    trace = hand_trace()
    assert trace.compute_kw is None
    assert trace.requests is None
    assert trace.rated_kw is None
    assert trace.resample_compute(1.0) is None
    assert trace.scaled_to(500.0).compute_kw is None
    assert trace.provenance == Provenance()


@pytest.mark.parametrize(
    ("compute_kw", "message"),
    [
        ([1, 1], r"'bad': compute_kw has 2 samples, power_kw 3; give one for each time"),
        ([1, -1, 0], r"'bad': index 1: compute_kw is -1.0, not within 0 and the power 2; it is the part of the power"),
        ([1, 2, 4], r"'bad': index 2: compute_kw is 4.0, not within 0 and the power 3"),
        ([np.nan, 2, 3], r"'bad': index 0: compute_kw is nan"),
        ([[1, 2, 3]], r"'bad': compute_kw has shape \(1, 3\)"),
        (["a", "b", "c"], r"'bad': compute_kw is not a list of numbers"),
    ],
)
def test_bad_compute_is_named(compute_kw, message):
    with pytest.raises(TraceError, match=message):
        PowerTrace([0, 1, 2], [1, 2, 3], "bad", compute_kw=compute_kw)


@given(samples=held_samples, steps=st.integers(1, 50), part=st.floats(0.0, 1.0))
def test_compute_is_averaged_like_power(samples, steps, part):
    power_kw = np.array([power for _, power in samples])
    trace = PowerTrace(np.cumsum([gap for gap, _ in samples]), power_kw, compute_kw=part * power_kw)
    dt_s = trace.duration_s / steps
    compute_kw = trace.resample_compute(dt_s)
    assert compute_kw is not None
    np.testing.assert_allclose(compute_kw, part * trace.resample(dt_s), rtol=1e-9, atol=1e-9)
