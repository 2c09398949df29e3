"""Tasks spread over processes that are started afresh (spawn), one task each at a time.

A process of the pool runs its numerical libraries on one thread, leaves Ctrl-C to the parent, and ends with it. One
that dies (a crash in compiled code, out of memory) costs its task alone.
"""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import TypeVar

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "DCGRID_NUM_THREADS")
SECONDS_TO_END = 10.0

Task = TypeVar("Task")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Died:
    """In place of a result: the process ended with this exit code, a signal's number negative, before it had one."""

    exit_code: int | None


def each(work: Callable[[Task], Result], tasks: Sequence[Task], jobs: int) -> Iterator[tuple[Task, Result | Died]]:
    """``work`` of every task, in the order in which they are done; what it raises is raised here.

    ``work`` is a function of a module, and tasks and results are sent as pickles. With one job all is done in this
    process. Leaving the iterator (Ctrl-C included) ends the processes. To be called from the main thread.
    """
    jobs = min(jobs, len(tasks))
    if jobs <= 1:
        yield from ((task, work(task)) for task in tasks)
        return
    waiting = list(reversed(tasks))
    busy: dict[Connection, tuple[SpawnProcess, Task]] = {}
    started: list[tuple[SpawnProcess, Connection]] = []
    try:
        for _ in range(jobs):
            _give(_start(work, started), waiting, busy)
        while busy:
            for pipe in wait(list(busy)):
                assert isinstance(pipe, Connection)
                process, task = busy.pop(pipe)
                try:
                    result = pipe.recv()
                except (EOFError, ConnectionError):
                    process.join()
                    result = Died(process.exitcode)
                    process, pipe = _start(work, started) if waiting else (process, pipe)
                _give((process, pipe), waiting, busy)
                if isinstance(result, BaseException):
                    raise result
                yield task, result
    except BaseException:
        for process, _ in started:  # an interrupt may have come between two tasks of a process: all, not the busy ones
            process.terminate()
        raise
    finally:
        _end_all(started)


def _end_all(started: Sequence[tuple[SpawnProcess, Connection]]) -> None:
    for _, pipe in started:
        pipe.close()
    for process, _ in started:
        process.join(SECONDS_TO_END)
        if process.is_alive():  # the exception that SIGTERM raises was lost in code that lets none through
            process.kill()
            process.join()


def _start(
    work: Callable[[Task], Result], started: list[tuple[SpawnProcess, Connection]]
) -> tuple[SpawnProcess, Connection]:
    spawn = get_context("spawn")
    ours, theirs = spawn.Pipe()
    with _settings_of_a_child():
        process = spawn.Process(target=_serve, args=(work, theirs), daemon=True)
        process.start()
        started.append((process, ours))
    theirs.close()
    return process, ours


def _give(
    worker: tuple[SpawnProcess, Connection], waiting: list[Task], busy: dict[Connection, tuple[SpawnProcess, Task]]
) -> None:
    """Hand a worker its next task, or let it end."""
    process, pipe = worker
    if not waiting:
        pipe.close()
        return
    task = waiting.pop()
    busy[pipe] = (process, task)
    with contextlib.suppress(ConnectionError):  # dead already: the next read tells
        pipe.send(task)


def _serve(work: Callable[[Task], Result], pipe: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # not inherited everywhere
    with terminated_in_order():
        while True:
            try:
                task = pipe.recv()
            except (EOFError, ConnectionError):
                return
            try:
                result = work(task)
            except Exception as error:
                result = error
            try:
                pipe.send(result)
            except ConnectionError:  # nobody waits for it: the parent was interrupted while this process worked
                return


@contextlib.contextmanager
def terminated_in_order() -> Iterator[None]:
    """Let SIGTERM end the process by an exception, so that what is half written goes, as under Ctrl-C."""
    before = signal.signal(signal.SIGTERM, _end)
    try:
        yield
    except _Terminated as terminated:
        raise SystemExit(terminated.args[0]) from None
    finally:
        signal.signal(signal.SIGTERM, before)


def _end(number: int, frame: object) -> None:
    raise _Terminated(128 + number)


class _Terminated(BaseException):
    """SIGTERM has come; no SystemExit, which a user's own code may raise and which is then a failure of that code."""


@contextlib.contextmanager
def _settings_of_a_child() -> Iterator[None]:
    """What a process is started with: one thread for libraries as they are loaded, and no Ctrl-C from the first on."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        with _held_back_interrupt():
            yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextlib.contextmanager
def _held_back_interrupt() -> Iterator[None]:
    """Keep Ctrl-C from a child from its first moment on; where signals can be blocked, this process has it later."""
    if hasattr(signal, "pthread_sigmask"):
        from multiprocessing import resource_tracker

        resource_tracker.ensure_running()  # its own start would unblock the signal
        blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        return
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler or signal.SIG_DFL)
