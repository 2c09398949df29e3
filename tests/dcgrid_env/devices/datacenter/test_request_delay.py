"""Delays of single requests: cases worked by hand, and laws of the curves that they are read from."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcgrid_env.devices.datacenter.request_delay import RequestDelays, Served, request_delays, serve_requests
from dcgrid_env.traces import RequestTimes


def column(*values: float) -> np.ndarray:
    return np.array(values)[:, None]


def requests(*rows: tuple[float, float, float]) -> RequestTimes:
    times = np.array(rows, dtype=np.float64).reshape(-1, 3).T
    return RequestTimes(*times, prefill_s=0.0 * times[0])


def served(
    rows: RequestTimes, arrived: np.ndarray, done: np.ndarray, dt_s: float = 1.0, begin_s: float = 0.0
) -> Served:
    return serve_requests(rows, begin_s, arrived, done, np.ones_like(done), dt_s)


# --- by hand -------------------------------------------------------------------------------------

# Work 10 and 10, served 5 a second: A = 0 10 20 20 20 and S = 0 5 10 15 20 at 0 .. 4 s.
ARRIVED, DONE = column(10, 10, 0, 0), column(5, 5, 5, 5)


def test_a_queue_worked_by_hand():
    # Prefill due at 0.5: A = 5, which S is at 1 s. At 1.5: 15, at 3 s. At 2: 20, at 4 s. At 3 nothing new: 20, at 4 s.
    rows = requests((0.25, 0.25, 1.25), (1.0, 0.5, 1.0), (1.5, 0.5, 1.5))
    found = served(rows, ARRIVED, DONE)
    assert found.ttft_s.tolist() == pytest.approx([0.25 + 0.5, 0.5 + 1.5, 0.5 + 2.0])
    # End to end no earlier than the later of the two.
    assert found.e2e_s.tolist() == pytest.approx([1.25 + 1.5, 1.0 + 2.0, 1.5 + 2.0])
    assert not found.unfinished.any()


def test_steps_have_their_length_and_the_episode_its_place_in_the_trace():
    rows = requests((99.9, 0.0, 0.0), (100.0, 1.0, 5.0), (105.0, 2.5, 2.5), (119.9, 0.1, 0.1), (120.0, 0.0, 0.0))
    found = served(rows, ARRIVED, DONE, dt_s=5.0, begin_s=100.0)
    # The first arrives before the first step and the last after the last. Due at 1 s: A = 10, served at 2 s.
    assert found.ttft_s.tolist() == pytest.approx([1.0 + 1.0, 2.5 + 7.5, 0.1 + 0.0])
    assert found.e2e_s.tolist() == pytest.approx([5.0 + 5.0, 2.5 + 7.5, 0.1 + 0.0])


def test_beyond_the_end_is_the_end():
    # All is served there, so whatever ends later is on time.
    found = served(requests((3.5, 0.5, 70.0)), ARRIVED, DONE)
    assert (found.ttft_s[0], found.e2e_s[0], found.unfinished[0]) == (0.5, 70.0, False)


def test_work_never_served_counts_with_the_end():
    rows = requests((0.5, 0.0, 0.0), (1.5, 0.0, 0.0), (3.0, 0.0, 9.0))
    found = served(rows, ARRIVED, column(5, 5, 0, 0))
    assert found.ttft_s.tolist() == pytest.approx([0.5, 2.5, 1.0])
    assert found.unfinished.tolist() == [False, True, True]
    # The third's last token would come after the end: its work lies in the queue all the same.
    assert found.e2e_s.tolist() == pytest.approx([0.5, 2.5, 10.0])


def test_each_work_class_has_a_queue_of_its_own():
    # Prefill waits: 10 at 5 a second; decode is served as it comes, and then the other way round.
    waits, flows = (column(10, 0, 0), column(5, 5, 0)), (column(4, 4, 4), column(4, 4, 4))
    rows = requests((0.0, 0.5, 1.5))
    found = served(rows, np.hstack((waits[0], flows[0])), np.hstack((waits[1], flows[1])))
    assert (found.ttft_s[0], found.e2e_s[0]) == pytest.approx((0.5 + 0.5, 1.5 + 0.5))
    found = served(rows, np.hstack((flows[0], waits[0])), np.hstack((flows[1], waits[1])))
    assert (found.ttft_s[0], found.e2e_s[0]) == pytest.approx((0.5, 1.5 + 0.5))


def test_a_pause_is_no_delay():
    # The work of the first step is done at its end, not when the next comes along; rounding does not change that.
    rows = requests((0.5, 0.5, 0.5), (1.5, 0.5, 0.5), (2.9, 0.1, 1.1))
    for short in (1.0, 1.0 - 1e-15):
        found = served(rows, column(0.1, 0, 0, 0.3), short * column(0.1, 0, 0, 0.3))
        assert found.ttft_s.tolist() == [0.5, 0.5, 0.1]
        assert found.e2e_s.tolist() == [0.5, 0.5, 1.1]
        assert not found.unfinished.any()


def test_no_work_delays_nobody():
    found = served(requests((0.5, 0.5, 0.7)), column(0, 0), column(0, 0))
    assert (found.ttft_s[0], found.e2e_s[0], found.unfinished[0]) == (0.5, 0.7, False)


def test_figures_over_all_sites():
    one = Served(np.array([1.0, 3.0]), np.array([10.0, 30.0]), np.array([True, False]))
    two = Served(np.array([2.0, 4.0]), np.array([20.0, 40.0]), np.array([False, True]))
    wanted = RequestDelays(4, 50.0, 2.5, 2.0, 4.0, 4.0, 25.0, 20.0, 40.0, 40.0)
    assert request_delays([one, two]) == wanted
    hundred = np.arange(1.0, 101.0)
    many = request_delays([Served(hundred[::-1], 2.0 * hundred, hundred > 100)])
    assert many[2:6] == (50.5, 50.0, 95.0, 99.0)
    assert (many.requests_sampled, many.requests_unfinished_pct, many.e2e_p99_s) == (100, 0.0, 198.0)


def test_no_request_has_no_delay():
    none = served(requests(), ARRIVED, DONE)
    assert request_delays([none, none]) == RequestDelays(0, 0, *[0.0] * 8)


# --- for any course ------------------------------------------------------------------------------

amounts = st.one_of(st.just(0), st.integers(0, 20))


def course(drawn: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
    """Return the arriving work and the part of it that the capacities serve."""
    backlog, done = 0, []
    for came, capacity in drawn:
        done.append(min(backlog + came, capacity))
        backlog += came - done[-1]
    return column(*(float(came) for came, _ in drawn)), column(*map(float, done))


def finished_at(level: float, done: np.ndarray, dt_s: float) -> float | None:
    """Return when so much work has been served, found step by step; None if never."""
    so_far = 0.0
    for step, work in enumerate(done.ravel()):
        if level <= so_far:
            return step * dt_s
        if level <= so_far + work:
            return (step + (level - so_far) / work) * dt_s
        so_far += work
    return len(done) * dt_s if level <= so_far else None


@pytest.mark.parametrize("dt_s", [0.5, 1.0, 5.0])
@given(drawn=st.lists(st.tuples(amounts, amounts), min_size=1, max_size=40), seed=st.integers(0, 1000))
@pytest.mark.slow
def test_against_a_walk_along_the_curves(dt_s, drawn, seed):
    arrived, done = course(drawn)
    end_s = len(drawn) * dt_s
    due = np.sort(np.random.default_rng(seed).uniform(0.0, end_s, 30))
    found = served(RequestTimes(due, 0.0 * due, 0.0 * due, 0.0 * due), arrived, done, dt_s)
    levels = np.interp(due, dt_s * np.arange(len(drawn) + 1), np.r_[0.0, np.cumsum(arrived)])
    for tau, level, ttft, left in zip(due, levels, found.ttft_s, found.unfinished, strict=True):
        at = finished_at(level - 1e-9 * float(arrived.sum()), done, dt_s)
        assert left == (at is None)
        assert ttft == pytest.approx(max((end_s if at is None else at) - tau, 0.0), abs=1e-6)
    np.testing.assert_array_equal(found.e2e_s, found.ttft_s)
    assert np.all(np.diff(due + found.ttft_s) >= -1e-6), "first come first served"


def test_mean_over_work_is_the_area_between_the_curves():
    # Some work in every step, so that a level belongs to one instant, and nothing left at the end.
    rng = np.random.default_rng(1)
    arrived, done = course(list(zip(rng.integers(1, 20, 60).tolist(), rng.integers(0, 20, 60).tolist(), strict=True)))
    done[-1] += arrived.sum() - done.sum()
    a, s = (np.r_[0.0, np.cumsum(work)] for work in (arrived, done))
    due = np.interp((np.arange(100_000) + 0.5) / 100_000 * a[-1], a, np.arange(61.0))
    found = served(RequestTimes(due, 0.0 * due, 0.0 * due, 0.0 * due), arrived, done)
    area = np.sum(0.5 * ((a - s)[1:] + (a - s)[:-1]))
    assert area > 100.0
    assert found.ttft_s.mean() * a[-1] == pytest.approx(area, rel=1e-5)


def test_inputs_are_left_alone():
    rows = requests((0.25, 0.25, 1.25))
    for array in (*rows, ARRIVED, DONE):
        array.flags.writeable = False
    served(rows, ARRIVED, DONE)


def test_a_lower_clock_stretches_what_is_being_served():
    # At 1 s the speeds fall to 1/2 for prefill and 4/5 for decode; nothing queues.
    speed = np.array([[1.0, 1.0], [0.5, 0.8], [0.5, 0.8]])
    work = np.ones((3, 2))
    first = RequestTimes(np.array([0.0, 0.5]), np.array([0.5, 1.0]), np.array([0.75, 5.0]), np.array([0.2, 0.3]))
    found = serve_requests(first, 0.0, work, work, speed, 1.0)
    # The second is read at half the speed, and answered from 1.5 s to 5.5 s at 4/5, beyond the end as at the end.
    assert found.ttft_s.tolist() == pytest.approx([0.5, 1.0 + 0.3])
    assert found.e2e_s.tolist() == pytest.approx([0.75, 5.0 + 0.3 + 4.0 * 0.25])
