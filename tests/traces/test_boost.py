"""Short draws above the rating: how high, for how long, and at what the work is counted."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env.traces import GRID_S, IDLE_SHARE, TRACE_SOURCES, PowerTrace, TraceError, from_recordings, library
from dcgrid_env.traces.boost import AVERAGING_S, boosted

# Everything that is drawn for compute-bound work.
BUSY = (np.array([IDLE_SHARE] * 20 + [1.0] * 60), np.array([0.0] * 20 + [1.0 - IDLE_SHARE] * 60))


def mean_before(share):
    """The moving average of the draw before each step, from idle on."""
    mean, means = IDLE_SHARE, []
    for value in [IDLE_SHARE, *share[:-1]]:
        mean += GRID_S / AVERAGING_S * (value - mean)
        means.append(mean)
    return np.array(means)


def test_a_start_from_idle_is_high_and_fades():
    drawn, compute = boosted(*BUSY, 1.3)
    assert (drawn[:20] == IDLE_SHARE).all()
    np.testing.assert_allclose(drawn[20:29], 1.0 + 0.3 * (1.0 - IDLE_SHARE), atol=1e-6)
    # What the average has not yet seen, (1 - a)^k of the rise after k steps, is all that is left of it.
    np.testing.assert_allclose(drawn[35:], 1.0 + (1.0 - IDLE_SHARE) * 0.9 ** np.arange(15, 60), atol=1e-6)
    np.testing.assert_allclose(drawn - compute, BUSY[0] - BUSY[1], atol=1e-6)


def test_no_boost_changes_nothing():
    drawn, compute = boosted(*BUSY, 1.0)
    np.testing.assert_allclose(drawn, BUSY[0], atol=1e-6)
    np.testing.assert_allclose(compute, BUSY[1], atol=1e-6)


def test_work_that_does_not_follow_the_clock_does_not_boost():
    share = np.where(np.arange(100) % 20 < 10, IDLE_SHARE, 0.8)
    drawn, compute = boosted(share, np.zeros(100), 1.3)
    np.testing.assert_allclose(drawn, share, atol=1e-6)
    assert compute.max() <= 1e-6


@settings(max_examples=60, deadline=None)
@given(
    levels=st.lists(st.tuples(st.floats(IDLE_SHARE, 1.0), st.floats(0.0, 1.0)), min_size=1, max_size=200),
    boost_share=st.floats(1.0, 2.0),
)
def test_any_draw_stays_in_bounds(levels, boost_share):
    share = np.array([level for level, _ in levels])
    compute = (share - IDLE_SHARE) * np.array([part for _, part in levels])
    drawn, followed = boosted(share, compute, boost_share)
    assert (drawn >= share - 1e-6).all()
    assert (drawn <= share + (boost_share - 1.0) * compute + 1e-6).all()
    # Never further above than the average is below.
    assert (drawn - share <= np.maximum(share - mean_before(share), 0.0) + 1e-6).all()
    # What is drawn beyond is work that follows the clock.
    np.testing.assert_allclose(followed - compute, drawn - share, atol=1e-6)


@pytest.mark.parametrize("source", TRACE_SOURCES)
def test_rows_of_the_library_rise_above_the_rating_for_a_moment(source):
    plain, high = (library(source, "train", 0.1, 240.0, 4, boost_share=boost) for boost in (1.0, 1.3))
    assert plain.p_share.max() <= 1.0
    # The chat service hardly reads on all GPUs at once, so that its peaks stay below the rating.
    assert high.p_share.max() > 1.0 or source == "chat"
    assert high.p_share.max() <= 1.3
    assert plain.p_share.max() < high.p_share.max()
    assert (high.p_share >= plain.p_share - 1e-6).all()
    for row, base in zip(high.p_share, plain.p_share, strict=True):
        assert (row - base <= np.maximum(base - mean_before(base), 0.0) + 1e-6).all()
    # What is above the plain row does compute-bound work.
    assert plain.compute_share is not None
    assert high.compute_share is not None
    work = [plain.compute_share * (plain.p_share - IDLE_SHARE), high.compute_share * (high.p_share - IDLE_SHARE)]
    np.testing.assert_allclose(work[1] - work[0], high.p_share - plain.p_share, atol=1e-5)
    assert high.compute_share.max() <= 1.0


@pytest.mark.parametrize("source", ["inference", "code", "llama3-70b"])
def test_boosted_rows_hold_the_same_energy_at_any_step(source):
    fine, coarse = (library(source, "train", dt_s, 60.0, 2, boost_share=1.3) for dt_s in (0.1, 1.0))
    np.testing.assert_allclose(fine.p_share.reshape(2, 60, 10).mean(axis=2), coarse.p_share, atol=1e-9)


def test_a_recording_has_its_peak_at_the_boost():
    trace = PowerTrace(np.arange(101.0), np.linspace(1.0, 4.0, 101))
    plain, high = (from_recordings([trace], "test", 1.0, boost_share=boost).p_share for boost in (1.0, 1.2))
    np.testing.assert_allclose(high, 1.2 * plain)


@pytest.mark.parametrize("boost_share", [0.99, 2.01, np.nan])
def test_a_boost_out_of_range_is_named(boost_share):
    with pytest.raises(TraceError, match=r"boost_share = .* is not in 1 to 2; give the highest draw"):
        library("inference", "train", 1.0, 60.0, 1, boost_share=boost_share)
    with pytest.raises(TraceError, match=r"boost_share = .* is not in 1 to 2"):
        from_recordings([PowerTrace([0, 99], [1, 1])], "train", 1.0, boost_share=boost_share)
