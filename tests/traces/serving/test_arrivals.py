"""Laws of arrival: counts and distances against theory, the daily cycle, and what they refuse."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from dcgrid_env.traces import Arrivals, TraceError

HOUR_S = 3600.0


def drawn(law, duration_s, seed=1, begin_s=0.0):
    return np.concatenate(list(law.draw(np.random.default_rng(seed), duration_s, begin_s)))


def fano(arrival_s, duration_s, window_s):
    """Variance over mean of the counts in whole windows."""
    counts = np.histogram(arrival_s, np.arange(int(duration_s / window_s) + 1) * window_s)[0]
    return counts.var() / counts.mean()


@pytest.mark.parametrize("window_s", [0.1, 1.0, 10.0, 60.0])
def test_poisson_counts_vary_as_much_as_their_mean_at_all_windows(window_s):
    arrival_s = drawn(Arrivals(20.0), 40_000.0)
    assert len(arrival_s) == pytest.approx(800_000, rel=0.01)
    # Over n windows the factor itself varies by sqrt(2 / n).
    assert abs(fano(arrival_s, 40_000.0, window_s) - 1.0) < 4.0 * np.sqrt(2.0 * window_s / 40_000.0)


def test_poisson_distances_are_exponential_and_independent():
    gap_s = np.diff(drawn(Arrivals(3.0), 10_000.0))
    assert stats.kstest(gap_s, "expon", args=(0.0, 1.0 / 3.0)).pvalue > 0.01
    assert abs(np.corrcoef(gap_s[:-1], gap_s[1:])[0, 1]) < 0.02


@pytest.mark.parametrize("shape", [0.25, 0.84, 1.0, 4.0, 100.0])
def test_gamma_distances_vary_by_one_over_the_root_of_the_shape(shape):
    gap_s = np.diff(drawn(Arrivals(5.0, shape=shape), 60_000.0))
    assert gap_s.mean() == pytest.approx(0.2, rel=0.02)
    assert gap_s.std() / gap_s.mean() == pytest.approx(1.0 / np.sqrt(shape), rel=0.02)


@pytest.mark.parametrize("window_s", [1.0, 10.0, 100.0])
@pytest.mark.slow
def test_two_state_counts_follow_the_theory(window_s):
    law = Arrivals(10.0, calm_rate=0.1, calm_s=40.0, busy_s=20.0)
    duration_s = 400_000.0
    arrival_s = drawn(law, duration_s)
    assert len(arrival_s) / duration_s == pytest.approx(10.0, rel=0.03)
    # Fischer and Meier-Hellstern, 1993: busy 25/s for 20 s, calm 2.5/s for 40 s.
    tau_s, variance = 1.0 / (1.0 / 40.0 + 1.0 / 20.0), (25.0 - 2.5) ** 2 * (2.0 / 3.0) * (1.0 / 3.0)
    within = 1.0 - tau_s / window_s * (1.0 - np.exp(-window_s / tau_s))
    expected = 1.0 + 2.0 * variance * tau_s / 10.0 * within
    assert fano(arrival_s, duration_s, window_s) == pytest.approx(expected, rel=0.06)


def test_two_state_dwells_and_rates_show_where_the_calm_is_silent():
    # 70/s in the busy state: no distance within it comes near 0.4 s.
    arrival_s = drawn(Arrivals(20.0, calm_rate=0.0, calm_s=5.0, busy_s=2.0), 40_000.0)
    gap_s = np.diff(arrival_s)
    silent = gap_s > 0.4
    # An exponential time is without memory: what is left of the silences beyond 0.4 s is as long again.
    assert np.mean(gap_s[silent] - 0.4) == pytest.approx(5.0, rel=0.05)
    busy_s = gap_s[~silent].sum()
    assert busy_s / 40_000.0 == pytest.approx(2.0 / 7.0, rel=0.05)
    assert np.count_nonzero(~silent) / busy_s == pytest.approx(70.0, rel=0.05)
    assert np.count_nonzero(silent) == pytest.approx(40_000.0 / 7.0 * np.exp(-0.4 / 5.0), rel=0.05)


@pytest.mark.slow
def test_both_states_come_first_as_often_as_they_hold():
    law = Arrivals(1.0, calm_rate=0.0, calm_s=3e6, busy_s=1e6)
    # The busy rate is 4/s, so that 10 s of it are hardly ever empty.
    busy = np.mean([len(drawn(law, 10.0, seed)) > 0 for seed in range(400)])
    assert busy == pytest.approx(0.25, abs=0.06)


@pytest.mark.parametrize("law", [Arrivals(2.0), Arrivals(2.0, shape=0.5, calm_rate=0.3, calm_s=30.0, busy_s=20.0)])
@pytest.mark.parametrize(("peak_hour", "begin_hour"), [(15.0, 0.0), (3.0, 0.0), (15.0, 9.0)])
def test_hourly_counts_follow_the_daily_cycle(law, peak_hour, begin_hour):
    law = replace(law, daily_swing=0.6, peak_hour=peak_hour)
    days = 10
    arrival_s = drawn(law, days * 24 * HOUR_S, begin_s=begin_hour * HOUR_S)
    hour_of_day = (arrival_s / HOUR_S + begin_hour) % 24.0
    counts = np.histogram(hour_of_day, np.arange(25.0))[0] / (2.0 * HOUR_S * days)
    middle = np.arange(24) + 0.5
    expected = 1.0 + 0.6 * np.cos(2.0 * np.pi * (middle - peak_hour) / 24.0)
    np.testing.assert_allclose(counts, expected, atol=0.12)
    # A cycle moves requests about and adds none.
    assert counts.mean() == pytest.approx(1.0, abs=0.02)


def test_a_full_swing_leaves_the_quietest_hour_empty():
    arrival_s = drawn(Arrivals(5.0, daily_swing=1.0, peak_hour=12.0), 24 * HOUR_S)
    counts = np.histogram(arrival_s, np.arange(25.0) * HOUR_S)[0]
    assert counts[0] < 0.02 * counts[12]


def test_same_seed_same_bytes_and_another_seed_others():
    law = Arrivals(5.0, shape=0.5, calm_rate=0.2, calm_s=9.0, busy_s=5.0, daily_swing=0.3)
    assert drawn(law, 900.0, 3).tobytes() == drawn(law, 900.0, 3).tobytes()
    assert not np.array_equal(drawn(law, 900.0, 3)[:100], drawn(law, 900.0, 4)[:100])


def test_many_arrivals_come_in_parts_that_follow_on():
    parts = list(Arrivals(100.0).draw(np.random.default_rng(1), 2000.0))
    assert len(parts) >= 3
    whole = np.concatenate(parts)
    assert (np.diff(whole) >= 0).all()
    # No seam between parts: the distance across is like any other.
    seams = [second[0] - first[-1] for first, second in pairwise(parts)]
    assert max(seams) < 0.2


def test_nothing_may_come_at_all():
    assert drawn(Arrivals(1e-9), 60.0).shape == (0,)
    assert drawn(Arrivals(1e-9, calm_rate=0.0, daily_swing=1.0), 0.05).shape == (0,)


@settings(max_examples=60, deadline=None)
@given(
    law=st.builds(
        Arrivals,
        rate_per_s=st.floats(1e-3, 50.0),
        shape=st.floats(0.1, 20.0),
        calm_rate=st.floats(0.0, 1.0),
        calm_s=st.floats(0.1, 1e4),
        busy_s=st.floats(0.1, 1e4),
        daily_swing=st.floats(0.0, 1.0),
        peak_hour=st.floats(0.0, 24.0),
    ),
    duration_s=st.floats(0.01, 1000.0),
    begin_s=st.floats(-1e5, 1e5),
    seed=st.integers(0, 2**32),
)
def test_any_law_gives_sorted_times_within_the_duration(law, duration_s, begin_s, seed):
    arrival_s = drawn(law, duration_s, seed, begin_s)
    assert (np.diff(arrival_s) >= 0).all()
    assert arrival_s.min(initial=0.0) >= 0.0
    assert arrival_s.max(initial=0.0) < duration_s
    # To the microsecond, so that the last bits of a platform do not show.
    np.testing.assert_allclose(arrival_s * 1e6, np.rint(arrival_s * 1e6), atol=1e-4)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rate_per_s": 0.0}, r"Arrivals.rate_per_s = 0.0 is not a finite number above 0"),
        ({"rate_per_s": np.nan}, r"Arrivals.rate_per_s = nan"),
        ({"shape": -1.0}, r"Arrivals.shape = -1.0"),
        ({"calm_s": 0.0}, r"Arrivals.calm_s = 0.0"),
        ({"busy_s": np.inf}, r"Arrivals.busy_s = inf"),
        ({"calm_rate": 1.1}, r"Arrivals.calm_rate = 1.1 is not in 0 to 1"),
        ({"calm_rate": -0.1}, r"Arrivals.calm_rate = -0.1"),
        ({"daily_swing": 2.0}, r"Arrivals.daily_swing = 2.0 is not in 0 to 1"),
        ({"peak_hour": 25.0}, r"Arrivals.peak_hour = 25.0 is not in 0 to 24"),
        ({"peak_hour": np.nan}, r"Arrivals.peak_hour = nan"),
    ],
)
def test_bad_laws_are_named(options, message):
    with pytest.raises(TraceError, match=message):
        Arrivals(**{"rate_per_s": 1.0, **options})


def test_regular_waves_keep_their_mean_rate_and_period():
    law = Arrivals(4.0, calm_rate=0.1, calm_s=40.0, busy_s=20.0, dwell_shape=25.0)
    counts = np.zeros(24_000)
    firsts = []
    for seed in range(8):
        arrival_s = np.concatenate(list(law.draw(np.random.default_rng(seed), 24_000.0)))
        own = np.bincount(arrival_s.astype(int), minlength=24_000)
        counts += own
        firsts.append(float(np.abs(np.fft.rfft(own - own.mean()))[1:].argmax() + 1) / 24_000.0)
    assert counts.mean() / 8 == pytest.approx(4.0, rel=0.02)
    np.testing.assert_allclose(1.0 / np.array(firsts), 60.0, atol=4.0)
    # Begun at any time of a wave: the first minute is like the rest.
    begun = [np.concatenate(list(law.draw(np.random.default_rng(seed), 60.0))) for seed in range(300)]
    first_s = np.bincount(np.concatenate(begun).astype(int), minlength=60) / 300
    np.testing.assert_allclose(first_s.reshape(6, 10).mean(axis=1), 4.0, rtol=0.25)
