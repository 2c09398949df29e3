"""Lateness of work: figures from steps late, and courses worked by hand."""

import numpy as np
import pytest

from dcgrid_env.devices.datacenter.lateness import late_figures, lateness
from dcgrid_env.devices.datacenter.streaming_waiting import WaitingTimes, added
from dcgrid_env.devices.datacenter.waiting_time import fcfs_delays


def test_figures_from_steps_late():
    interactive = np.array([0.0, 2.0, 1.0]), np.array([6.0, 1.0, 3.0])
    deferrable = np.array([0.0, 5.0]), np.array([9.0, 1.0])
    assert late_figures([interactive, deferrable], 2.0) == pytest.approx(
        {
            "in_time_pct": 75.0,
            "interactive_in_time_pct": 60.0,
            "deferrable_in_time_pct": 90.0,
            "lateness_mean_s": 2.0 * (2.0 + 3.0 + 5.0) / 20.0,
            "lateness_p95_s": 2.0 * 2.0,
        }
    )
    nothing = [(np.zeros(0), np.zeros(0))] * 2
    assert list(late_figures(nothing, 2.0).values()) == [100.0, 100.0, 100.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("by_deadline", "served", "expected"),
    [
        # 10 kW at step 0: 6 of it interactive, due in step 0, and 4 deferrable, due in step 2.
        (True, [6.0, 0.0, 4.0, 0.0], (100.0, 100.0, 100.0, 0.0)),
        (True, [0.0, 6.0, 0.0, 4.0], (0.0, 0.0, 0.0, 1.0)),
        (False, [5.0, 5.0, 0.0, 0.0], (70.0, 50.0, 100.0, 0.3)),
        (False, [0.0, 0.0, 0.0, 10.0], (0.0, 0.0, 0.0, 0.6 * 3.0 + 0.4)),
        (False, [0.0, 0.0, 0.0, 0.0], (0.0, 0.0, 0.0, 0.6 * 4.0 + 0.4 * 2.0)),
    ],
)
def test_courses_worked_by_hand(by_deadline, served, expected):
    arrived = np.array([[10.0], [0.0], [0.0], [0.0]])
    found = lateness(arrived, 0.0 * arrived, np.array(served)[:, None], (0, 2), 0.6, by_deadline, 1.0)
    names = ("in_time_pct", "interactive_in_time_pct", "deferrable_in_time_pct", "lateness_mean_s")
    assert [found[name] for name in names] == pytest.approx(expected, abs=1e-5)


def test_moved_work_is_due_a_step_earlier():
    arrived = np.array([[10.0], [0.0], [0.0]])
    found = lateness(arrived, 0.5 * arrived, np.array([[0.0], [10.0], [0.0]]), (1, 2), 1.0, False, 1.0)
    assert (found["in_time_pct"], found["lateness_mean_s"]) == (pytest.approx(50.0), pytest.approx(0.5))


def test_work_by_waiting_steps_is_added_up_and_extended():
    np.testing.assert_array_equal(
        added(np.array([1.0, 2.0]), np.array([0, 3, 3]), np.array([5.0, 1.0, 2.0])), [6, 2, 0, 3]
    )
    np.testing.assert_array_equal(added(np.array([1.0, 2.0]), np.zeros(0, np.int64), np.zeros(0)), [1.0, 2.0])
    np.testing.assert_array_equal(added(np.array([1.0, 2.0, 4.0]), np.array([1]), np.array([3.0])), [1.0, 5.0, 4.0])


@pytest.mark.parametrize("parts", [[3, 4], [1] * 7, [7]])
def test_waiting_times_of_parts_are_those_of_the_whole(parts):
    rng = np.random.default_rng(1)
    arrived = rng.choice([0.0, 1.0, 5.0], (7, 3))
    arrived[:, 2] = 0.0
    served = np.zeros((7, 3))
    for step in range(7):  # no work is served before it arrives
        queue = arrived[: step + 1].sum(axis=0) - served.sum(axis=0)
        served[step] = np.minimum(queue, rng.choice([0.0, 2.0], 3))
    times, at = WaitingTimes(2.0), 0
    for n in parts:
        times.add(arrived[at : at + n], served[at : at + n])
        at += n
        assert times.steps == at
    assert tuple(times.delays()) == pytest.approx(tuple(fcfs_delays(arrived, served, 2.0)))
    assert WaitingTimes(2.0).delays() == (0.0,) * 6


def test_waiting_times_worked_by_hand():
    times = WaitingTimes(2.0)
    times.add(np.array([[4.0], [0.0]]), np.array([[1.0], [0.0]]))
    times.add(np.array([[0.0], [0.0]]), np.array([[2.0], [0.0]]))
    # 1 kW served at once, 2 kW two steps later, and 1 kW still waits after four steps.
    found = times.delays()
    assert found.mean_s == pytest.approx((2 * 4.0 + 1 * 8.0) / 4.0)
    assert (found.p50_s, found.p95_s, found.p99_s) == (4.0, 8.0, 8.0)
    assert (found.arrived_kws, found.unserved_kws) == (8.0, 2.0)
