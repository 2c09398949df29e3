"""Units on this machine: results, deaths, errors, Ctrl-C, and what a process is started with."""

import contextlib
import math
import os
import signal
import time
from multiprocessing import active_children

import pytest

from dcgrid_env.core.work import local_pool
from dcgrid_env.core.work.local_pool import LocalPool
from dcgrid_env.core.work.unit import Lost, LostUnits, Needs, Unit, require_all
from dcgrid_env.core.work.worker import THREADS, Terminated, attempt, shared


def units(work, items):
    return [Unit(f"unit {item}", work, item) for item in items]


def done(work, items, n, values=None):
    return {unit.item: result for unit, result in LocalPool(n).run(units(work, items), values)}


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.slow
def test_every_unit_has_its_result(n):
    assert done(math.sqrt, [9.0, 16.0, 25.0], n) == {9.0: 3.0, 16.0: 4.0, 25.0: 5.0}
    assert done(math.sqrt, [], n) == {}


def test_one_worker_does_units_in_their_order():
    assert [unit.item for unit, _ in LocalPool(1).run(units(math.sqrt, [25.0, 9.0, 16.0]))] == [25.0, 9.0, 16.0]


def killed_at_first(item):
    """Die by SIGKILL as often as the item says, counted in a file; then the number of tries."""
    path, deaths = item
    with open(path, "a") as file:
        file.write("x")
    tries = os.path.getsize(path)
    if tries <= deaths:
        os.kill(os.getpid(), signal.SIGKILL)
    return tries


@pytest.mark.slow
def test_a_unit_whose_worker_is_killed_is_tried_twice_again_and_then_named(tmp_path):
    items = [(str(tmp_path / str(deaths)), deaths) for deaths in range(4)]
    found = done(killed_at_first, items, 2)
    assert [found[item] for item in items[:3]] == [1, 2, 3]
    assert found[items[3]] == Lost("its process ended with exit code -9, 3 times")
    assert os.path.getsize(items[3][0]) == 3
    assert not active_children()


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.slow
def test_what_a_unit_raises_is_not_tried_again_and_named_when_the_others_are_done(n):
    results = LocalPool(n).results(units(math.sqrt, [-1.0, 4.0, 9.0]))
    assert {result for _, result in (next(results), next(results))} == {2.0, 3.0}
    with pytest.raises(LostUnits, match=r"^1 of 3 not done: unit -1.0: .*; the same command goes on") as raised:
        next(results)
    assert isinstance(raised.value.__cause__, ValueError)
    assert "Traceback" in raised.value.__cause__.__notes__[0]
    assert not active_children()


@pytest.mark.parametrize("error", [None, ValueError("no")])
def test_a_traceback_is_offered_where_some_work_raised(error):
    with pytest.raises(LostUnits, match=r"^1 of 2 not done: a: gone") as raised:
        require_all({"a": Lost("gone", error)}, 2)
    assert raised.value.traced is (error is not None)


class Awkward(Exception):
    """Exception that cannot be restored from its pickle."""

    def __init__(self, first, second):
        super().__init__(f"{first} and {second}")


def awkward(item):
    raise Awkward("this", item) if item else SystemExit(3)


@pytest.mark.slow
def test_an_error_that_cannot_travel_is_described_and_so_is_what_cannot_be_sent():
    asked = [Unit("exit", awkward, 0), Unit("awkward", awkward, 1), Unit("function", len, (lambda: 0,))]
    found = {unit.key: result for unit, result in LocalPool(2).run(asked)}
    assert found["exit"].reason == "SystemExit: 3"
    assert found["awkward"].reason == "Awkward: this and 1"
    assert found["function"].reason.startswith("it cannot be sent to a process: ")


@pytest.mark.slow
def test_a_process_has_one_thread_the_shared_values_and_no_ctrl_c_and_leaves_no_trace_here():
    before = dict(os.environ), signal.getsignal(signal.SIGINT)
    asked = [Unit(name, os.getenv, name) for name in THREADS]
    asked += [Unit("a", shared, "a"), Unit("c", shared, "c"), Unit("signal", signal.getsignal, signal.SIGINT)]
    found = {unit.key: result for unit, result in LocalPool(2).run(asked, {"a": [1], "b": 2})}
    assert [found[name] for name in THREADS] == ["1"] * len(THREADS)
    assert (found["a"], found["c"], found["signal"]) == ([1], None, signal.SIG_IGN)
    assert done(shared, ["a", "c"], 1, {"a": [1]}) == {"a": [1], "c": None}
    assert shared("a") is None
    assert (dict(os.environ), signal.getsignal(signal.SIGINT)) == before


@pytest.mark.slow
def test_a_unit_of_many_cores_runs_alone(tmp_path):
    wide = [Unit(str(i), alone, str(tmp_path / "one"), Needs(2)) for i in range(3)]
    assert [result for _, result in LocalPool(2).run(wide)] == [True] * 3


def alone(path):
    with open(path, "x"):
        time.sleep(0.05)
    os.remove(path)
    return True


@pytest.mark.slow
def test_leaving_early_ends_the_processes():
    results = LocalPool(2).run(units(math.sqrt, [float(i) for i in range(50)]))
    next(results)
    assert active_children()
    results.close()  # pyright: ignore[reportAttributeAccessIssue]
    assert not active_children()


@pytest.mark.parametrize("at", [2, 3, 5])
@pytest.mark.slow
def test_an_interrupt_between_two_units_of_a_process_ends_it(at, monkeypatch):
    """The process that had just done its unit is no longer busy and has no other: it is to end nevertheless."""
    begin, calls = local_pool._Workers.begin, []

    def interrupted(self, unit):
        calls.append(unit)
        if len(calls) == at:
            raise KeyboardInterrupt
        return begin(self, unit)

    monkeypatch.setattr(local_pool._Workers, "begin", interrupted)
    with pytest.raises(KeyboardInterrupt):
        list(LocalPool(2).run(units(math.sqrt, [float(i) for i in range(10)])))
    assert not active_children()


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="signals cannot be blocked here")
def test_an_interrupt_while_a_process_starts_comes_afterwards():
    def interrupted_while_starting():
        with local_pool._held_back_interrupt():
            signal.raise_signal(signal.SIGINT)
            pending.extend(signal.sigpending())

    pending: list[int] = []
    with pytest.raises(KeyboardInterrupt):
        interrupted_while_starting()
    assert pending == [signal.SIGINT]


@pytest.mark.slow
def test_a_process_that_lets_no_exception_through_is_killed(monkeypatch):
    monkeypatch.setattr(local_pool, "SECONDS_TO_END", 0.2)
    results = LocalPool(2).run(units(_deaf, ["quick", "deaf", "deaf"]))
    next(results)
    results.close()  # pyright: ignore[reportAttributeAccessIssue]
    assert not active_children()


def _deaf(item):
    until = time.monotonic() + (60.0 if item == "deaf" else 0.0)
    while time.monotonic() < until:
        with contextlib.suppress(BaseException):
            time.sleep(0.1)


def test_a_termination_is_no_failure_of_the_work():
    def ended(_):
        raise Terminated(143)

    with pytest.raises(Terminated):
        attempt(ended, 0)
