"""Rows over threads: how many, which rows, and in a child process made by fork."""

import itertools
import multiprocessing
import os
import sys
import threading
import time
import warnings

import numpy as np
import pytest

from dcgrid_env import distflow, load_feeder
from dcgrid_env.core.threads import ROWS_PER_THREAD, n_threads, over_rows


@pytest.mark.parametrize("threads", ["1", "2", "3"])
@pytest.mark.parametrize("n_row", [0, 1, 63, 64, 127, 128, 200, 1001])
def test_slices_cover_every_row_once(monkeypatch, threads, n_row):
    monkeypatch.setenv("DCGRID_NUM_THREADS", threads)
    slices = []

    def work(first, last):
        slices.append((first, last))
        return last - first

    assert over_rows(work, n_row) == n_row
    slices.sort()
    assert len(slices) == max(1, min(int(threads), n_row // ROWS_PER_THREAD))
    assert slices[0][0] == 0
    assert slices[-1][1] == n_row
    assert all(a[1] == b[0] for a, b in itertools.pairwise(slices))


def test_as_many_threads_as_cores_unless_told(monkeypatch):
    monkeypatch.delenv("DCGRID_NUM_THREADS", raising=False)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {1, 3, 5} if pid == 0 else {1}, raising=False)
    assert n_threads() == 3
    monkeypatch.delattr(os, "sched_getaffinity")
    for cores, threads in ((7, 7), (None, 1)):
        monkeypatch.setattr(os, "cpu_count", lambda cores=cores: cores)
        assert n_threads() == threads
    monkeypatch.setenv("DCGRID_NUM_THREADS", "1")
    assert n_threads() == 1


def test_two_threads_work_at_the_same_time(monkeypatch):
    monkeypatch.setenv("DCGRID_NUM_THREADS", "2")
    meet = threading.Barrier(2, timeout=30)

    def work(first, last):
        meet.wait()  # passed by two at once or by none
        return threading.current_thread() is not threading.main_thread()

    assert over_rows(work, 200) == 1  # the caller's thread is one of the two


def test_few_rows_and_one_thread_stay_on_the_callers_thread(monkeypatch):
    caller = threading.current_thread()
    assert over_rows(lambda first, last: threading.current_thread() is caller, 2 * ROWS_PER_THREAD - 1)
    monkeypatch.setenv("DCGRID_NUM_THREADS", "1")
    assert over_rows(lambda first, last: threading.current_thread() is caller, 10000)


def test_an_error_in_a_thread_reaches_the_caller(monkeypatch):
    monkeypatch.setenv("DCGRID_NUM_THREADS", "2")

    def work(first, last):
        raise RuntimeError("in a row")

    with pytest.raises(RuntimeError, match="in a row"):
        over_rows(work, 200)
    ended = []

    def last_fails(first, last):
        if last == 200:
            raise RuntimeError("in the caller's")
        time.sleep(0.05)
        ended.append(first)
        return 0

    with pytest.raises(RuntimeError, match="in the caller's"):
        over_rows(last_fails, 200)
    assert ended == [0]  # nothing goes on behind the caller's back


def test_number_of_threads(monkeypatch):
    monkeypatch.setenv("DCGRID_NUM_THREADS", "7")
    assert n_threads() == 7
    monkeypatch.delenv("DCGRID_NUM_THREADS")
    assert n_threads() >= 1


@pytest.mark.parametrize("asked", ["0", "-1", "two", "1.5", " "])
def test_a_bad_number_of_threads_is_named(monkeypatch, asked):
    monkeypatch.setenv("DCGRID_NUM_THREADS", asked)
    with pytest.raises(ValueError, match=r"DCGRID_NUM_THREADS is .*whole number"):
        n_threads()


def solve_200():
    feeder = load_feeder("ieee33")
    scale = np.linspace(0.1, 1.5, 200)[:, None]
    return distflow(feeder, scale * feeder.p_load_kw, scale * feeder.q_load_kvar).v_pu


def _child(connection):
    connection.send(solve_200().tobytes())
    connection.close()


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="this system has no fork")
def test_a_forked_child_can_solve_after_its_parent_used_threads(monkeypatch):
    monkeypatch.setenv("DCGRID_NUM_THREADS", "2")
    expected = solve_200().tobytes()
    assert any(thread.name.startswith("dcgrid") for thread in threading.enumerate())
    context = multiprocessing.get_context("fork")
    mine, childs = context.Pipe(duplex=False)
    child = context.Process(target=_child, args=(childs,))
    with warnings.catch_warnings():
        if sys.version_info >= (3, 12):  # Python warns of every fork beside threads; that it works is what is tested
            warnings.simplefilter("ignore", DeprecationWarning)
        child.start()
    childs.close()
    try:
        assert mine.poll(60), "the child did not answer: its threads hang"
        assert mine.recv() == expected
        child.join(30)
        assert child.exitcode == 0
    finally:
        child.kill()
        child.join(30)
    assert solve_200().tobytes() == expected
