"""Units on this machine: executors of concurrent.futures with one process each, as many as there are workers.

An executor of several processes breaks as a whole if one of them dies, and does not report the unit of that process.
With one process each, only the running unit is lost, its identity is certain, and the executor is replaced.
"""

from __future__ import annotations

import contextlib
import os
import signal
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import active_children, connection, get_context
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from dcgrid_env.core.versions import command_words
from dcgrid_env.core.work.packing import packed
from dcgrid_env.core.work.unit import TRIES, Lost, Place, Unit
from dcgrid_env.core.work.worker import THREADS, attempt, attempt_in_process, begin_process, sharing

SECONDS_TO_END = 10.0
"""Time that a worker has to end after it was asked to; then it is killed."""

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class LocalPool(Place):
    """Processes of this machine that are started afresh (spawn), each with one thread of each numerical library.

    With one worker, or one unit, all is done in this process. To be called from the main thread.
    """

    n: int = 1
    """Number of processes."""
    is_remote = False

    @property
    def workers(self) -> int:
        """Number of processes."""
        return self.n

    def run(
        self, units: Sequence[Unit[Item, Result]], shared: Mapping[str, Any] | None = None
    ) -> Iterator[tuple[Unit[Item, Result], Result | Lost]]:
        """See ``Place.run``; a unit whose process dies is tried again behind those that wait."""
        values = dict(shared or {})
        if min(self.n, len(units)) <= 1:
            for unit in units:
                with sharing(values):
                    result = attempt(unit.work, unit.item)
                yield unit, result
            return
        workers = _Workers(packed(values))
        waiting = deque((unit, 1) for unit in units)
        busy: dict[Future[Any], tuple[_Worker, Unit[Item, Result], int]] = {}
        try:
            while waiting or busy:
                while waiting and self._has_room(waiting[0][0], busy):
                    unit, tries = waiting.popleft()
                    worker, future = workers.begin(unit)
                    busy[future] = worker, unit, tries
                for future in wait(busy, return_when=FIRST_COMPLETED).done:
                    worker, unit, tries = busy.pop(future)
                    try:
                        result = future.result()
                    except BrokenProcessPool:
                        code = workers.buried(worker)
                        if tries < TRIES:
                            waiting.append((unit, tries + 1))
                            continue
                        result = Lost(f"its process ended with exit code {code}, {TRIES} times")
                    except Exception as error:  # it cannot be pickled
                        workers.idle.append(worker)
                        result = Lost(f"it cannot be sent to a process: {error}", error)
                    else:
                        workers.idle.append(worker)
                    yield unit, result
        except BaseException:
            workers.terminate()
            raise
        finally:
            workers.end()

    def _has_room(self, unit: Unit[Any, Any], busy: Mapping[Any, tuple[_Worker, Unit[Any, Any], int]]) -> bool:
        """Whether a unit's cores are free; one that wants more than there are runs alone."""
        taken = sum(max(1.0, running.needs.cores) for _, running, _ in busy.values())
        return not busy or taken + max(1.0, unit.needs.cores) <= self.n


ONE_PROCESS = LocalPool()
"""This process alone."""


@dataclass(frozen=True, eq=False)
class _Worker:
    """An executor and its one process."""

    executor: ProcessPoolExecutor
    process: BaseProcess


class _Workers:
    """The workers of a run: those that are idle, and all that have been started and not buried."""

    def __init__(self, values: bytes):
        self.values = values
        self.idle: list[_Worker] = []
        self.started: list[_Worker] = []

    def begin(self, unit: Unit[Any, Any]) -> tuple[_Worker, Future[Any]]:
        """Assign a unit to an idle worker, or to a new one."""
        while self.idle:
            worker = self.idle.pop()
            try:
                return worker, worker.executor.submit(attempt_in_process, unit.work, unit.item, command_words())
            except BrokenProcessPool:  # it died while it was idle
                self.buried(worker)
        with _settings_of_a_worker():
            before = set(active_children())
            executor = ProcessPoolExecutor(1, get_context("spawn"), begin_process, (self.values,))
            future = executor.submit(attempt_in_process, unit.work, unit.item, command_words())
            (process,) = set(active_children()) - before
            worker = _Worker(executor, process)
            self.started.append(worker)
        return worker, future

    def buried(self, worker: _Worker) -> int | None:
        """Return the exit code of a dead worker, negative for a signal, and remove the worker."""
        self.started.remove(worker)
        worker.executor.shutdown()  # reaps the process
        return worker.process.exitcode

    def terminate(self) -> None:
        """Ask all to end: an interrupt may have come between two units of a worker, so not the busy ones alone."""
        for worker in self.started:
            worker.process.terminate()
        for worker in self.started:
            if not connection.wait([worker.process.sentinel], SECONDS_TO_END):
                worker.process.kill()  # the exception that SIGTERM raises was lost in code that lets none through

    def end(self) -> None:
        """End all that are left, which are idle or terminated."""
        for worker in self.started:
            worker.executor.shutdown(cancel_futures=True)


@contextlib.contextmanager
def _settings_of_a_worker() -> Iterator[None]:
    """Start processes in the block with one thread for each library, and without Ctrl-C from the start."""
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
