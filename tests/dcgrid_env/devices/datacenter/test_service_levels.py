"""Service levels: order of service, overdue work and its cost; no work is lost or free."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env import DcgridVectorEnv, Recorder, Routing, ServiceLevels, action_layout
from dcgrid_env.core.checked import FieldError
from dcgrid_env.devices.datacenter.lateness import lateness
from dcgrid_env.devices.datacenter.service_levels import serve_by_slack
from helpers.routing import routed

WORK = st.lists(st.tuples(st.floats(0.0, 100.0), st.floats(0.0, 1.0), st.floats(0.0, 1.3)), min_size=1, max_size=25)


def followed(course, soon, later, share, by_deadline, dt_s=1.0):
    """Queue, overdue and served work over time, of one site whose steps are (arrived, part moved, part served)."""
    queue, rows = np.zeros((1, 1, later + 1)), []
    for arrived, moved, part in course:
        at_hand = arrived * dt_s + queue.sum()
        served = min(part, 1.0) * at_hand / dt_s
        given_ = [np.array([[x]]) for x in (moved * arrived, arrived, served)]
        queue, overdue, due = serve_by_slack(queue, *given_, dt_s, soon, later, share, by_deadline)
        rows.append((queue, overdue[0, 0], due[0, 0], moved * arrived, arrived, served))
    return rows


@settings(max_examples=100, deadline=None)
@given(WORK, st.integers(0, 3), st.integers(1, 5), st.floats(0.0, 1.0), st.booleans())
def test_work_is_conserved_and_charged_as_late_as_it_is_served(course, soon, more, share, by_deadline):
    later = soon + more
    rows = followed(course, soon, later, share, by_deadline)
    arrived, served = (np.array([[row[i]] for row in rows]) for i in (4, 5))
    moved = np.array([[row[3]] for row in rows])
    left = arrived.sum() - served.sum()
    assert rows[-1][0].sum() == pytest.approx(left, abs=1e-6)
    assert min(row[0].min() for row in rows) >= -1e-9
    figures = lateness(arrived, moved, served, (soon, later), share, by_deadline, 1.0)
    late = figures["lateness_mean_s"] * arrived.sum()
    if soon >= 1 or not moved.any():  # a target within a step cannot be a step less
        assert sum(row[1] for row in rows) == pytest.approx(late, rel=1e-6, abs=1e-4)
    assert 0.0 <= figures["in_time_pct"] <= 100.0 + 1e-9


@settings(max_examples=50, deadline=None)
@given(WORK, st.integers(0, 3), st.integers(1, 5), st.floats(0.0, 1.0), st.booleans())
def test_arrays_and_tensors_agree(course, soon, more, share, by_deadline):
    queue, later = np.zeros((1, 1, soon + more + 1)), soon + more
    for arrived, moved, part in course:
        at = [np.array([[x]]) for x in (moved * arrived, arrived, part * (arrived + queue.sum()))]
        at[2] = np.minimum(at[2], at[1] + queue.sum())
        figures = (1.0, soon, later, share, by_deadline)
        arrays = serve_by_slack(queue, at[0], at[1], at[2], *figures)
        on_tensors = [torch.tensor(values) for values in (queue, *at)]
        tensors = serve_by_slack(on_tensors[0], on_tensors[1], on_tensors[2], on_tensors[3], *figures)
        for ours, theirs in zip(arrays, tensors, strict=True):
            assert theirs.numpy() == pytest.approx(ours, abs=1e-9)
        queue = arrays[0]


def test_the_earliest_deadline_is_served_first():
    # 10 kW s each of interactive and deferrable work, then 10 served a step.
    course = [(20.0, 0.0, 0.5), (0.0, 0.0, 1.0)]
    by_deadline, by_age = (followed(course, 0, 3, 0.5, first) for first in (True, False))
    assert [row[1] for row in by_deadline] == pytest.approx([0.0, 0.0])
    assert [row[1] for row in by_age] == pytest.approx([5.0, 0.0])


def test_what_was_moved_has_a_step_less():
    kept, moved = (followed([(10.0, part, 0.0), (0.0, 0.0, 0.0)], 1, 4, 1.0, True) for part in (0.0, 1.0))
    assert [row[1] for row in kept] == [0.0, 10.0]
    assert [row[1] for row in moved] == [10.0, 10.0]


def test_lateness_of_a_course_that_is_known():
    arrived, served = np.array([[10.0], [0.0], [0.0]]), np.array([[4.0], [0.0], [2.0]])
    figures = lateness(arrived, 0.0 * arrived, served, (0, 1), 0.6, True, 2.0)
    # Of 6 interactive kW 4 are in time and 2 are two steps late; 4 deferrable are two steps late at the end.
    assert figures["interactive_in_time_pct"] == pytest.approx(100.0 * 4.0 / 6.0)
    assert figures["deferrable_in_time_pct"] == 0.0
    assert figures["lateness_mean_s"] == pytest.approx(2.0 * (2 * 2.0 + 2 * 4.0) / 10.0)
    assert figures["lateness_p95_s"] == 4.0
    none = lateness(0.0 * arrived, 0.0 * arrived, 0.0 * served, (0, 1), 0.6, True, 2.0)
    assert none["in_time_pct"] == 100.0
    assert none["lateness_mean_s"] == 0.0


@pytest.mark.parametrize("order", ["edf", "fcfs"])
def test_late_work_and_what_is_left_at_the_end_are_charged(order):
    levels = ServiceLevels(target_s=1.0, deadline_s=4.0, order=order, late_weight=2.0)
    s = routed(datacenters={"service": levels, "batching": None}, weights={"backlog": 0.0}, horizon=30)
    env = DcgridVectorEnv(1, s)
    env.reset(seed=[2])
    recorder, clock = Recorder(s, env.transition), action_layout(s).is_channel("clock")
    while not recorder.over:
        env.step(np.where(clock, -1.0, 0.0)[None].astype(np.float32))
        recorder.add(env.transition)
    metrics, state = recorder.series(0).metrics(), env.transition.state
    assert metrics["cost_late"] > 0.0 == metrics["cost_backlog"]
    assert metrics["cost_leftover"] == pytest.approx(9.0 * state.backlog_kws.sum() / 2400.0 / 30)
    assert metrics["unserved_kws"] == pytest.approx(state.backlog_kws.sum())
    late = metrics["lateness_mean_s"] * metrics["arrived_kws"]
    assert metrics["cost_late"] * 30 == pytest.approx(2.0 * late / 2400.0, rel=1e-6)
    assert metrics["in_time_pct"] < 90.0


def test_a_price_on_lateness_has_a_derivative_by_what_is_served():
    served = torch.tensor([[4.0]], dtype=torch.float64, requires_grad=True)
    queue = torch.tensor([[[3.0, 2.0, 6.0]]], dtype=torch.float64)
    _, overdue, _ = serve_by_slack(queue, None, torch.zeros((1, 1), dtype=torch.float64), served, 1.0, 1, 2, 0.5, True)
    overdue.sum().backward()
    assert overdue.item() == pytest.approx(1.0)
    assert served.grad is not None
    assert served.grad.item() == pytest.approx(-1.0)


@pytest.mark.parametrize(("target_s", "deadline_s", "dt_s", "slack"), [
    (2.0, 30.0, 1.0, (2, 30)), (0.3, 0.7, 0.1, (3, 7)), (0.0, 1.9, 1.0, (0, 1)), (2.99, 5.01, 1.0, (2, 5)),
])  # fmt: skip
def test_slack_is_in_whole_steps(target_s, deadline_s, dt_s, slack):
    assert ServiceLevels(target_s=target_s, deadline_s=deadline_s).slack(dt_s) == slack


def test_a_deadline_is_one_step_to_600_steps_away():
    for deadline_s in (0.5, 300.0):
        ServiceLevels(target_s=0.0, deadline_s=deadline_s).check_step(0.5)
    with pytest.raises(
        FieldError, match=r"service.deadline_s is 300.1; give at most 600 steps, 300 s, or longer steps"
    ):
        ServiceLevels(deadline_s=300.1).check_step(0.5)
    with pytest.raises(FieldError, match=r"service.deadline_s is 0.49; give at least one step, 0.5 s"):
        ServiceLevels(target_s=0.0, deadline_s=0.49).check_step(0.5)
    with pytest.raises(FieldError, match=r"deadline_s is 2.0; give more than target_s = 2"):
        ServiceLevels(target_s=2.0, deadline_s=2.0)


def test_a_move_takes_one_step_at_most():
    Routing(move_latency_s=0.5).check_step(0.5)
    with pytest.raises(FieldError, match=r"routing.move_latency_s is 0.51; give at most one step, dt_s = 0.5, or 0"):
        Routing(move_latency_s=0.51).check_step(0.5)
