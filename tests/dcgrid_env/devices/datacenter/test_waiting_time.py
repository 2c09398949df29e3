"""Waiting times, first come first served: cases worked by hand, and a queue simulated parcel by parcel."""

from collections import deque
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env.devices.datacenter.waiting_time import Delays, fcfs_delays


class Work(NamedTuple):
    kws: float
    waited_s: float


def column(*values: float) -> np.ndarray:
    return np.array(values)[:, None]


def queue(arrived_kw: np.ndarray, served_kw: np.ndarray, dt_s: float) -> tuple[list[Work], float]:
    """The naive way: one queue of (step of arrival, work) a site, emptied from its front. Work, and what is left."""
    done, left = [], 0.0
    for arrived, served in zip(arrived_kw.T, served_kw.T, strict=True):
        waiting: deque[list[float]] = deque()
        for step in range(len(arrived)):
            if arrived[step] > 0:
                waiting.append([step, arrived[step] * dt_s])
            budget = served[step] * dt_s
            while budget > 0 and waiting:
                taken = min(budget, waiting[0][1])
                done.append(Work(taken, (step - waiting[0][0]) * dt_s))
                budget -= taken
                waiting[0][1] -= taken
                if waiting[0][1] <= 0:
                    waiting.popleft()
        for came, kws in waiting:  # counts with its age at the end
            done.append(Work(kws, (len(arrived) - came) * dt_s))
            left += kws
    return done, left


def quantile(work: list[Work], share: float) -> float:
    """The least delay that this share of the work does not exceed."""
    whole, so_far = sum(w.kws for w in work), 0.0
    for kws, waited in sorted(work, key=lambda w: w.waited_s):
        so_far += kws
        if so_far >= share * whole - 1e-9 * whole:
            return waited
    raise AssertionError


# --- by hand -------------------------------------------------------------------------------------


def test_work_served_as_it_comes_has_not_waited():
    assert fcfs_delays(column(5, 0, 3), column(5, 0, 3), 1.0) == Delays(0, 0, 0, 0, 8, 0)


def test_work_put_off_by_two_steps():
    assert fcfs_delays(column(10, 0, 0), column(0, 0, 10), 1.0) == Delays(2, 2, 2, 2, 10, 0)
    assert fcfs_delays(column(10, 0, 0), column(0, 0, 10), 0.1) == pytest.approx(Delays(0.2, 0.2, 0.2, 0.2, 1, 0))
    assert fcfs_delays(column(10, 0, 0), column(0, 0, 10), 5.0) == Delays(10, 10, 10, 10, 50, 0)


def test_the_first_come_is_the_first_served():
    # 4 come at step 0 and 4 at step 1; 2 a step are served: 2 wait 0, 2 wait 1; then 2 wait 1 and 2 wait 2.
    found = fcfs_delays(column(4, 4, 0, 0), column(2, 2, 2, 2), 1.0)
    assert found == Delays(mean_s=1.0, p50_s=1.0, p95_s=2.0, p99_s=2.0, arrived_kws=8.0, unserved_kws=0.0)
    # Served newest first, 2 would have waited 0 and 2 of the first lot 3.


def test_a_step_that_serves_parts_of_two_lots():
    # 3 at step 0, 3 at step 1; 2, 3, 1 served: 2 wait 0; 1 waits 1, 2 wait 0; 1 waits 1.
    found = fcfs_delays(column(3, 3, 0), column(2, 3, 1), 1.0)
    assert found.mean_s == pytest.approx(2 / 6)
    assert (found.p50_s, found.p95_s, found.p99_s) == (0, 1, 1)


def test_unserved_work_counts_with_its_age():
    # 6 at step 0 of which 2 are served at once: 4 are left with an age of 3 steps; 1 at step 2 with an age of 1.
    found = fcfs_delays(column(6, 0, 1), column(2, 0, 0), 2.0)
    assert found.mean_s == pytest.approx(2.0 * (2 * 0 + 4 * 3 + 1 * 1) / 7)
    assert found.unserved_kws == pytest.approx(10.0)
    assert found.arrived_kws == pytest.approx(14.0)
    assert (found.p50_s, found.p95_s, found.p99_s) == (6, 6, 6)


def test_nothing_served_at_all():
    assert fcfs_delays(column(1, 1), column(0, 0), 1.0) == Delays(1.5, 1, 2, 2, 2, 2)


def test_percentiles_are_weighted_by_work():
    # 90, 6, 3 and 1 of a hundred parts wait 0, 1, 2 and 3 steps.
    arrived = column(100, 0, 0, 0)
    found = fcfs_delays(arrived, column(90, 6, 3, 1), 1.0)
    assert (found.p50_s, found.p95_s, found.p99_s) == (0, 1, 2)
    assert found.mean_s == pytest.approx(0.15)
    # A share that is reached exactly is reached.
    found = fcfs_delays(arrived, column(50, 45, 4, 1), 1.0)
    assert (found.p50_s, found.p95_s, found.p99_s) == (0, 1, 2)
    found = fcfs_delays(arrived, column(49, 45, 4, 2), 1.0)
    assert (found.p50_s, found.p95_s, found.p99_s) == (1, 2, 3)


@pytest.mark.parametrize("shape", [(5, 2), (5, 0), (0, 2), (0, 0)])
def test_no_work_has_no_delay(shape):
    assert fcfs_delays(np.zeros(shape), np.zeros(shape), 1.0) == Delays(0, 0, 0, 0, 0, 0)


def test_sites_have_queues_of_their_own():
    # The first site puts 10 off by a step; the second serves its 30 at once, and its spare capacity helps nobody.
    arrived = np.array([[10.0, 30.0], [0.0, 0.0]])
    served = np.array([[0.0, 30.0], [10.0, 0.0]])
    assert fcfs_delays(arrived, served, 1.0) == Delays(0.25, 0, 1, 1, 40, 0)
    # A site that never works changes nothing.
    wider = [np.insert(a, 1, 0.0, axis=1) for a in (arrived, served)]
    assert fcfs_delays(wider[0], wider[1], 1.0) == Delays(0.25, 0, 1, 1, 40, 0)


def test_rounding_leaves_neither_work_nor_delay():
    arrived = np.full((30, 1), 0.1)
    served = arrived * (1 - 1e-15)
    served[10:] = np.nextafter(served[10:], 1)
    assert fcfs_delays(arrived, served, 1.0)._replace(arrived_kws=3.0) == Delays(0, 0, 0, 0, 3, 0)


# --- against the naive queue -----------------------------------------------------------------------

# Whole numbers, so that the naive queue has no rounding of its own; the first draws include idle steps.
amounts = st.one_of(st.just(0), st.integers(0, 20))
sites = st.lists(st.tuples(amounts, amounts), min_size=1, max_size=60)


def _course(drawn: list[list[tuple[int, int]]]) -> tuple[np.ndarray, np.ndarray]:
    """Arrivals and capacities of every site, (n_step, n_site), as what arrives and what is served."""
    n_step = max(map(len, drawn))
    arrived, served = np.zeros((2, n_step, len(drawn)))
    for site, course in enumerate(drawn):
        backlog = 0
        for step, (came, capacity) in enumerate(course):
            backlog += came
            taken = min(capacity, backlog)
            backlog -= taken
            arrived[step, site], served[step, site] = came, taken
    return arrived, served


@pytest.mark.parametrize(("dt_s", "scale"), [(1.0, 1.0), (0.5, 1.0), (0.1, 0.37), (5.0, 123.4)])
@settings(max_examples=80, deadline=None)
@given(drawn=st.lists(sites, min_size=1, max_size=3))
def test_against_a_queue_of_parcels(dt_s, scale, drawn):
    arrived, served = _course(drawn)
    work, left = queue(arrived, served, 1.0)
    found = fcfs_delays(scale * arrived, scale * served, dt_s)
    whole = sum(w.kws for w in work)
    assert found.arrived_kws == pytest.approx(whole * scale * dt_s)
    assert found.unserved_kws == pytest.approx(left * scale * dt_s, abs=1e-9 * max(1.0, whole))
    if whole == 0:
        assert found == Delays(0, 0, 0, 0, 0, 0)
        return
    assert found.mean_s == pytest.approx(sum(w.kws * w.waited_s for w in work) / whole * dt_s, abs=1e-9)
    wanted = [quantile(work, share) * dt_s for share in (0.5, 0.95, 0.99)]
    assert [found.p50_s, found.p95_s, found.p99_s] == pytest.approx(wanted, abs=1e-9)
    # Little: every parcel stands in the queue for as many ends of steps as it waits.
    backlog = np.cumsum(arrived - served, axis=0)
    assert found.mean_s * arrived.sum() == pytest.approx(backlog.sum() * dt_s, abs=1e-6)
    assert 0 <= found.p50_s <= found.p95_s <= found.p99_s <= len(arrived) * dt_s


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n_site=st.integers(1, 4))
def test_littles_law_for_any_figures(seed, n_site):
    rng = np.random.default_rng(seed)
    arrived = rng.gamma(0.3, 100.0, (200, n_site))
    served, backlog, stood = np.zeros_like(arrived), np.zeros(n_site), np.zeros_like(arrived)
    for step in range(200):
        served[step] = np.minimum(backlog + arrived[step], rng.uniform(0.0, 60.0, n_site))
        backlog = backlog + arrived[step] - served[step]
        stood[step] = backlog
    found = fcfs_delays(arrived, served, 0.5)
    assert found.mean_s == pytest.approx(stood.sum() * 0.5 / arrived.sum(), rel=1e-6)
    assert found.unserved_kws == pytest.approx(backlog.sum() * 0.5, rel=1e-6, abs=1e-6)
    assert found.arrived_kws == pytest.approx(arrived.sum() * 0.5)


def test_inputs_are_left_alone():
    arrived, served = column(3, 3, 0), column(2, 3, 1)
    arrived.flags.writeable = served.flags.writeable = False
    fcfs_delays(arrived, served, 1.0)
