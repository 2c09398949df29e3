"""Tasks over processes: results, deaths, errors, and what a process is started with."""

import contextlib
import math
import os
import signal
import time
from multiprocessing import active_children

import pytest

from dcgrid_env.core import processes
from dcgrid_env.core.processes import THREADS, Died, each


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_task_has_its_result(jobs):
    assert sorted(each(math.sqrt, [9.0, 16.0, 25.0], jobs)) == [(9.0, 3.0), (16.0, 4.0), (25.0, 5.0)]
    assert list(each(math.sqrt, [], jobs)) == []


def test_a_process_that_dies_costs_its_task_alone():
    codes = dict(each(os._exit, [3, 4, 5], 2))
    assert codes == {3: Died(3), 4: Died(4), 5: Died(5)}
    assert not active_children()


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_a_task_raises_is_raised_and_nothing_is_left_running(jobs):
    with pytest.raises(ValueError, match=r"math domain|nonnegative"):
        list(each(math.sqrt, [-1.0, 4.0, 9.0], jobs))
    assert not active_children()


def test_processes_have_one_thread_and_leave_no_trace_here():
    before = dict(os.environ), signal.getsignal(signal.SIGINT)
    assert dict(each(os.getenv, THREADS, 2)) == dict.fromkeys(THREADS, "1")
    assert (dict(os.environ), signal.getsignal(signal.SIGINT)) == before


def test_ctrl_c_is_the_parents():
    found = dict(each(signal.getsignal, [signal.SIGINT, signal.SIGTERM], 2))
    assert found[signal.SIGINT] == signal.SIG_IGN


def test_leaving_early_ends_the_processes():
    results = each(math.sqrt, [float(i) for i in range(50)], 2)
    next(results)
    assert active_children()
    results.close()  # pyright: ignore[reportAttributeAccessIssue]
    assert not active_children()


@pytest.mark.parametrize("at", range(2, 6))
def test_an_interrupt_between_two_tasks_of_a_process_ends_it(at, monkeypatch):
    """The process that had just done its task is no longer busy and has no other: it is to end nevertheless."""
    give, calls = processes._give, []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == at:
            raise KeyboardInterrupt
        give(*arguments)

    monkeypatch.setattr(processes, "_give", interrupted)
    with pytest.raises(KeyboardInterrupt):
        list(each(math.sqrt, [float(i) for i in range(10)], 2))
    assert not active_children()


def test_a_process_whose_result_nobody_waits_for_ends_in_order():
    process, pipe = processes._start(time.sleep, [])
    pipe.send(0.5)
    pipe.close()
    process.join(30.0)
    assert process.exitcode == 0


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="signals cannot be blocked here")
def test_an_interrupt_while_a_process_starts_comes_afterwards():
    def interrupted_while_starting():
        with processes._held_back_interrupt():
            signal.raise_signal(signal.SIGINT)
            pending.extend(signal.sigpending())

    pending: list[int] = []
    with pytest.raises(KeyboardInterrupt):
        interrupted_while_starting()
    assert pending == [signal.SIGINT]


def test_a_process_that_lets_no_exception_through_is_killed(monkeypatch):
    monkeypatch.setattr(processes, "SECONDS_TO_END", 0.2)
    results = each(_deaf, ["quick", "deaf", "deaf"], 2)
    next(results)
    results.close()  # pyright: ignore[reportAttributeAccessIssue]
    assert not active_children()


def _deaf(task):
    until = time.monotonic() + (60.0 if task == "deaf" else 0.0)
    while time.monotonic() < until:
        with contextlib.suppress(BaseException):
            time.sleep(0.1)
