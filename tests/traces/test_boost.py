"""Short draws above the rating: height, duration, and the counted work."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env.traces import (
    GRID_S,
    IDLE_SHARE,
    TRACE_SOURCES,
    PowerTrace,
    TraceError,
    from_recordings,
    generate_step,
    generate_training,
    library,
)
from dcgrid_env.traces.boost import GATHER_S, RESERVE_S, boosted, boosted_trace

# Draws above are multiples of a millionth, not rounded up.
MILLIONTH = 2.0**-20
# Everything that is drawn for compute-bound work.
BUSY = (np.array([IDLE_SHARE] * 20 + [1.0] * 60), np.array([0.0] * 20 + [1.0 - IDLE_SHARE] * 60))


def test_a_start_from_idle_reaches_the_boost_for_a_second():
    drawn, compute = boosted(*BUSY, 1.3)
    assert (drawn[:20] == IDLE_SHARE).all()
    np.testing.assert_allclose(drawn[20:30], 1.3, atol=MILLIONTH)
    # Nothing is gathered at the rating.
    assert (drawn[30:] == 1.0).all()
    np.testing.assert_array_equal(compute - BUSY[1], drawn - BUSY[0])


def test_the_reserve_is_gathered_again_in_50_s():
    pause_s = np.array([5.0, 25.0, 49.0, 60.0])
    second_s = []
    for idle_s in pause_s:
        level = np.concatenate((np.ones(20), np.zeros(round(idle_s / GRID_S)), np.ones(20)))
        drawn, _ = boosted(IDLE_SHARE + (1.0 - IDLE_SHARE) * level, (1.0 - IDLE_SHARE) * level, 1.3)
        second_s.append((drawn[-20:] - 1.0).sum() * GRID_S / 0.3)
    np.testing.assert_allclose(second_s, np.minimum(pause_s / GATHER_S, RESERVE_S), atol=1e-4)


@pytest.mark.parametrize("compute", [0.0, 0.3, 0.6])
def test_work_boosts_by_the_part_that_follows_the_clock(compute):
    drawn, _ = boosted(np.full(5, 0.9), np.full(5, compute), 1.2)
    np.testing.assert_allclose(drawn - 0.9, 0.2 * compute / (1.0 - IDLE_SHARE), atol=MILLIONTH)


@pytest.mark.parametrize("level", [1.0, 0.9, 0.4])
def test_a_long_level_is_drawn_as_it_is(level):
    drawn, _ = boosted(np.full(3000, level), np.full(3000, level - IDLE_SHARE), 1.3)
    np.testing.assert_allclose(drawn[100:], level, atol=1e-12)


@st.composite
def drawn_shares(draw):
    """Stretches of power and the part of it above idle that is compute-bound, on the grid."""
    share = st.one_of(st.just(1.0), st.floats(IDLE_SHARE, 1.0))
    compute = st.one_of(st.sampled_from([0.0, 1.0]), st.floats(0.0, 1.0))
    pieces = draw(st.lists(st.tuples(share, compute, st.integers(1, 200)), min_size=1, max_size=12))
    levels, parts, steps = (np.array(column) for column in zip(*pieces, strict=True))
    levels = np.repeat(levels, steps)
    return levels, (levels - IDLE_SHARE) * np.repeat(parts, steps)


@settings(max_examples=150, deadline=None)
@given(drawn=drawn_shares(), boost_share=st.one_of(st.sampled_from([1.1, 1.3, 2.0]), st.floats(1.0, 2.0)))
@pytest.mark.slow
def test_any_draw_stays_in_bounds(drawn, boost_share):
    share, compute = drawn
    high, followed = boosted(share, compute, boost_share)
    extra = high - share
    beyond = boost_share - 1.0
    assert (high >= share).all()
    assert (extra <= beyond * compute / (1.0 - IDLE_SHARE) + 1e-12).all()
    assert high.max() <= boost_share
    # What is drawn beyond is work that follows the clock.
    np.testing.assert_allclose(followed - compute, extra, atol=1e-12)
    assert (followed >= 0.0).all()
    # No window holds more than a full reserve and what is gathered in it.
    total = np.concatenate([[0.0], np.cumsum(extra) * GRID_S])
    above = total - beyond / GATHER_S * GRID_S * np.arange(len(total))
    assert (above - np.minimum.accumulate(above)).max() <= beyond * RESERVE_S + 1e-9


def test_a_spent_reserve_is_never_below_zero():
    # Half of the time at the rating, where nothing is gathered that would hide a rounding error.
    for seed in range(100):
        rng = np.random.default_rng(seed)
        share = np.where(rng.random(400) < 0.5, 1.0, rng.uniform(IDLE_SHARE, 1.0, 400))
        drawn, _ = boosted(share, (share - IDLE_SHARE) * rng.random(400), 1.3)
        assert (drawn >= share).all()


@settings(max_examples=50, deadline=None)
@given(drawn=drawn_shares())
def test_no_boost_changes_nothing(drawn):
    share, compute = drawn
    for before, after in zip(drawn, boosted(share, compute, 1.0), strict=True):
        np.testing.assert_array_equal(before, after)


def test_a_trace_keeps_what_it_knows():
    trace = generate_training(60.0, 4)
    high = boosted_trace(trace, 1.3)
    assert high.provenance == replace(trace.provenance, parameters={**trace.provenance.parameters, "boost_share": 1.3})
    assert (high.name, high.rated_kw, high.requests) == (trace.name, 1.0, None)
    np.testing.assert_allclose(high.time_s, trace.time_s)
    # A trace with few samples has its draws above on the grid all the same.
    step = boosted_trace(generate_step(60.0, 1), 1.3).resample(0.1)
    assert np.count_nonzero(step > 1.0) == 10
    np.testing.assert_allclose(step[200:210], 1.3, atol=MILLIONTH)


@pytest.mark.parametrize("source", TRACE_SOURCES)
def test_rows_of_the_library_rise_above_the_rating_for_a_moment(source):
    plain, high = (library(source, "train", 0.1, 600.0, 6, boost_share=boost) for boost in (1.0, 1.3))
    extra = high.p_share - plain.p_share
    assert plain.p_share.max() <= 1.0
    assert plain.p_share.max() < high.p_share.max() <= 1.3
    assert extra.min() >= 0.0
    # They cost hardly any energy.
    assert high.p_share.mean() <= 1.0125 * plain.p_share.mean()
    # What is above the plain row does compute-bound work.
    assert plain.compute_share is not None
    assert high.compute_share is not None
    work = [plain.compute_share * (plain.p_share - IDLE_SHARE), high.compute_share * (high.p_share - IDLE_SHARE)]
    np.testing.assert_allclose(work[1] - work[0], extra, atol=1e-5)
    assert (extra <= 0.3 * work[0] / (1.0 - IDLE_SHARE) + 1e-9).all()
    assert high.compute_share.max() <= 1.0


@pytest.mark.parametrize("source", ["inference", "training", "mixed", "step"])
def test_sources_that_work_at_the_rating_reach_the_boost(source):
    assert library(source, "train", 0.1, 600.0, 6, boost_share=1.3).p_share.max() > 1.25


@pytest.mark.parametrize("source", ["inference", "code", "llama3-70b"])
def test_boosted_rows_hold_the_same_energy_at_any_step(source):
    fine, coarse = (library(source, "train", dt_s, 60.0, 2, boost_share=1.3) for dt_s in (0.1, 1.0))
    np.testing.assert_allclose(fine.p_share.reshape(2, 60, 10).mean(axis=2), coarse.p_share, atol=1e-9)


def test_a_recording_of_an_unknown_rating_has_its_peak_at_the_boost():
    trace = PowerTrace(np.arange(101.0), np.linspace(1.0, 4.0, 101))
    plain, high = (from_recordings([trace], "test", 1.0, boost_share=boost).p_share for boost in (1.0, 1.2))
    np.testing.assert_allclose(high, 1.2 * plain)


@pytest.mark.parametrize("boost_share", [0.99, 2.01, np.nan])
def test_a_boost_out_of_range_is_named(boost_share):
    with pytest.raises(TraceError, match=r"boost_share = .* is not in 1 to 2; give the highest draw"):
        library("inference", "train", 1.0, 60.0, 1, boost_share=boost_share)
    with pytest.raises(TraceError, match=r"boost_share = .* is not in 1 to 2"):
        from_recordings([PowerTrace([0, 99], [1, 1])], "train", 1.0, boost_share=boost_share)
