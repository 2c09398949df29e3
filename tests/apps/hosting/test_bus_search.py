"""The search at a bus on margins that are known: it finds the largest size that carries, in few trials."""

import numpy as np
import pytest

from dcgrid_env.apps.hosting.bus_search import CRITICAL, BusSearch
from dcgrid_env.apps.hosting.trial import UNLIMITED, Trial

N = 40


def trial(margins):
    """A trial of samples with these margins of undervoltage, and one second outside where negative."""
    by_limit = np.full((len(margins), 3), UNLIMITED)
    by_limit[:, 0] = margins
    nothing = np.zeros((len(margins), 1))
    return Trial(by_limit, np.zeros_like(by_limit, dtype=int), (margins < 0.0).astype(int), nothing, nothing)


def searched(margin, guess=7, top=1000, allowed=0, scan=()):
    """Run a search on ``margin(size, samples)``; the search, and samples tried in all."""
    every, tried = np.arange(N), 0
    search = BusSearch(trial(margin(0, every)), every[:CRITICAL], guess, top, allowed, scan)
    while (request := search.next()) is not None:
        assert 0 < request.size <= top
        assert len(np.unique(request.samples)) == len(request.samples)
        tried += len(request.samples)
        assert tried < 60 * N, "does not end"
        search.take(request, trial(margin(request.size, request.samples)))
    return search, tried


def steep(size, samples):
    """The sample 3 is the worst, linear in the size."""
    return 0.5 - (1.0 - 0.01 * np.abs(samples - 3.0)) * size / 700.0


def bent(size, samples):
    """A plateau, then a square: nothing that a line foresees."""
    return 0.2 - np.maximum(size - 290.0 - samples, 0.0) ** 2 / 400.0


@pytest.mark.parametrize(("margin", "largest"), [(steep, 350), (bent, 298)])
@pytest.mark.parametrize("guess", [1, 100, 350, 900])
def test_finds_the_largest_size_that_carries_in_all_samples(margin, largest, guess):
    search, tried = searched(margin, guess)
    assert search.size == largest
    assert not search.at_size.outside.any()
    np.testing.assert_array_equal(search.at_size.margins[:, 0], margin(largest, np.arange(N)))
    assert search.beyond is not None
    assert search.beyond.outside.any()
    assert tried <= 2 * N + 25 * CRITICAL


@pytest.mark.parametrize(("start", "largest"), [(-1.0, 0), (1.0, 60)])
def test_nothing_and_everything_may_be_carried(start, largest):
    def flat(size, samples):
        return np.where(size > 0, start, 1.0) + 0.0 * samples

    search, _ = searched(flat, top=60)
    assert search.size == largest
    assert (search.beyond is None) == (largest == 60)


def test_a_sample_that_was_not_critical_before_decides():
    def late(size, samples):
        return np.where(samples == 30, np.where(size > 200, -1.0, 1.0), 0.5 - (1.0 + 0.01 * samples) * size / 900.0)

    assert searched(late, guess=20)[0].size == 200


def test_seconds_that_are_allowed_are_over_all_samples():
    def one_by_one(size, samples):
        return 0.5 - (size - 10 * samples) / 1000.0  # sample i breaks limits from size 501 + 10 i on

    for allowed in (0, 1, 5):
        assert searched(one_by_one, allowed=allowed)[0].size == 500 + 10 * allowed


def test_the_scan_finds_what_is_not_monotone():
    def gaps(size, samples):
        good = (size <= 210) and not 90 < size < 110
        return np.full(len(samples), 0.001 * abs(210 - size) + 0.001 if good or size >= 800 else -0.1)

    search, _ = searched(gaps, guess=200, scan=(25, 50, 100, 800))
    assert (search.size, search.smaller_fails, search.larger_carries) == (210, (100,), (800,))
