"""Units on this machine: results, deaths, errors, Ctrl-C, and what a process is started with."""

import contextlib
import math
import os
import re
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import active_children

import pytest

from dcgrid_env.core.signals import Terminated
from dcgrid_env.core.work import local_pool
from dcgrid_env.core.work.local_pool import DIED, LocalPool
from dcgrid_env.core.work.unit import ONE_THREAD, Lost, LostUnits, Unit, attempt, require_all, shared


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


def killed(path):
    """End by SIGKILL once the file exists; the unit without a path ends at once."""
    while path and not os.path.exists(path):
        time.sleep(0.05)
    return os.kill(os.getpid(), signal.SIGKILL) if path else "done"


@pytest.mark.slow
def test_a_killed_worker_costs_the_units_without_a_result_and_the_error_names_the_remedy(tmp_path):
    path = tmp_path / "first is done"
    results = LocalPool(2).results([Unit(f"seed {i}", killed, str(path) if i else "") for i in range(4)])
    assert next(results)[1] == "done"
    path.touch()
    with pytest.raises(LostUnits) as raised:
        list(results)
    remedy = "run the same command again: finished units are kept"
    found = re.fullmatch(f"3 of 4 not done: (.*): {re.escape(DIED)}; {remedy}", str(raised.value))
    assert found
    assert {*found[1].split(" / ")} == {"seed 1", "seed 2", "seed 3"}
    assert not raised.value.traced
    assert not active_children()


def test_units_that_come_after_the_death_of_a_worker_are_lost(monkeypatch):
    def broken(*_):
        raise BrokenProcessPool

    monkeypatch.setattr(local_pool.ProcessPoolExecutor, "submit", broken)
    assert done(math.sqrt, [1.0, 4.0], 2) == {1.0: Lost(DIED), 4.0: Lost(DIED)}


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.slow
def test_an_error_of_a_unit_is_raised_when_the_others_are_done(n):
    results = LocalPool(n).results(units(math.sqrt, [-1.0, 4.0, 9.0]))
    assert {result for _, result in (next(results), next(results))} == {2.0, 3.0}
    with pytest.raises(LostUnits, match=r"^1 of 3 not done: unit -1.0: .*; run the same command again") as raised:
        next(results)
    assert raised.value.traced
    assert "Traceback" in raised.value.__notes__[0]
    assert not active_children()


def test_reasons_are_grouped_and_long_lists_are_counted():
    lost = {f"seed {i}": Lost("gone") for i in range(12)} | {"seed 12": Lost("no memory")}
    with pytest.raises(LostUnits) as raised:
        require_all(lost, 20, "")
    keys = " / ".join(f"seed {i}" for i in range(10))
    assert str(raised.value) == f"13 of 20 not done: {keys} and 2 more: gone; seed 12: no memory"


class Awkward(Exception):
    """Exception that cannot be restored from its pickle."""

    def __init__(self, first, second):
        super().__init__(f"{first} and {second}")


def awkward(item):
    raise Awkward("this", item) if item else SystemExit(3)


@pytest.mark.slow
def test_an_error_that_cannot_travel_is_described_and_so_is_what_cannot_be_sent():
    asked = [Unit("exit", awkward, 0), Unit("awkward", awkward, 1), Unit("function", len, (lambda: 0,))]
    asked += [Unit("lock", len, (threading.Lock(),)), Unit("item", len, (Awkward("this", 1),))]
    found = {unit.key: result for unit, result in LocalPool(2).run(asked)}
    assert found["exit"].reason == "SystemExit: 3"
    assert found["awkward"].reason == "Awkward: this and 1"
    for key in ("function", "lock"):
        assert found[key].reason.startswith("it cannot be sent to a process: ")
    assert found["item"].reason.startswith("it cannot be sent to a process: Awkward.__init__() missing")


@pytest.mark.slow
def test_a_process_has_one_thread_the_shared_values_and_no_ctrl_c_and_leaves_no_trace_here():
    before = dict(os.environ), signal.getsignal(signal.SIGINT), signal.pthread_sigmask(signal.SIG_BLOCK, [])
    asked = [Unit(name, os.getenv, name) for name in ONE_THREAD]
    asked += [Unit("a", shared, "a"), Unit("c", shared, "c"), Unit("signal", signal.getsignal, signal.SIGINT)]
    found = {unit.key: result for unit, result in LocalPool(2).run(asked, {"a": [1], "b": 2})}
    assert [found[name] for name in ONE_THREAD] == ["1"] * len(ONE_THREAD)
    assert (found["a"], found["c"], found["signal"]) == ([1], None, signal.SIG_IGN)
    assert done(shared, ["a", "c"], 1, {"a": [1]}) == {"a": [1], "c": None}
    assert shared("a") is None
    assert (dict(os.environ), signal.getsignal(signal.SIGINT), signal.pthread_sigmask(signal.SIG_BLOCK, [])) == before


@pytest.mark.slow
def test_units_of_many_cores_run_one_at_a_time(tmp_path):
    wide = [Unit(str(i), alone, str(tmp_path / "one"), cores=2) for i in range(3)]
    assert [result for _, result in LocalPool(3).run(wide)] == [True] * 3


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


ORPHANS = """
import sys, time
from multiprocessing import active_children
from dcgrid_env.core.work.local_pool import LocalPool
from dcgrid_env.core.work.unit import Unit

if __name__ == "__main__":
    results = LocalPool(2).run([Unit(str(s), time.sleep, s) for s in (0.0, 300.0, 300.0)])
    next(results)
    print(*(child.pid for child in active_children()), flush=True)
    next(results)
"""


@pytest.mark.slow
@pytest.mark.skipif(not os.path.isdir("/proc"), reason="looks for processes in /proc")
def test_workers_end_with_a_killed_parent(tmp_path):
    (tmp_path / "orphans.py").write_text(ORPHANS)
    with subprocess.Popen([sys.executable, str(tmp_path / "orphans.py")], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        workers = parent.stdout.readline().split()
        parent.kill()
    assert len(workers) == 2
    while any(os.path.exists(f"/proc/{pid}") and "Z" not in _state(pid) for pid in workers):
        time.sleep(0.05)


def _state(pid):
    with contextlib.suppress(OSError), open(f"/proc/{pid}/stat") as file:
        return file.read().rpartition(")")[2].split()[0]
    return "Z"


def test_a_termination_is_no_failure_of_the_work():
    def ended(_):
        raise Terminated(143)

    with pytest.raises(Terminated):
        attempt(ended, 0)
