"""Units in processes of this machine: one executor of ``concurrent.futures``."""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import active_children, get_context, parent_process
from typing import Any

from dcgrid_env.core.signals import terminated_in_order
from dcgrid_env.core.versions import command_of, command_words
from dcgrid_env.core.work.unit import ONE_THREAD, Item, Lost, Place, Result, Unit, attempt, packed, share

DIED = "a worker process died: it was killed, or the memory was exhausted (give fewer --workers)"
SECONDS_TO_END = 15.0
"""Time in which a terminated worker must end; then it is killed."""


@dataclass(frozen=True)
class LocalPool(Place):
    """Fresh processes (spawn), each with one thread of each numerical library; one worker or unit runs in this process.

    If a process dies, all units without a result are lost. To be called from the main thread.
    """

    is_remote = False

    def run(
        self, units: Sequence[Unit[Item, Result]], shared: Mapping[str, Any] | None = None
    ) -> Iterator[tuple[Unit[Item, Result], Result | Lost]]:
        """See ``Place.run``; as many units run at once as the widest of them leaves cores for."""
        values = dict(shared or {})
        n = min(len(units), self.workers // max((unit.cores for unit in units), default=1))
        if n <= 1:
            for unit in units:
                before = share(values)
                try:
                    result = attempt(unit.work, unit.item)
                finally:
                    share(before)
                yield unit, result
            return
        others = set(active_children())
        pool = ProcessPoolExecutor(n, get_context("spawn"), _begin, (packed([values])[0],))
        try:
            with _worker_settings():  # submit starts the processes
                pending = {_submitted(pool, unit): unit for unit in units}
            for future in as_completed(pending):
                yield pending.pop(future), _result(future)
        except BaseException:
            workers = set(active_children()) - others
            for worker in workers:
                worker.terminate()
            for worker in workers:
                worker.join(SECONDS_TO_END)
                worker.kill()  # code that suppresses every exception does not end otherwise
            raise
        finally:
            pool.shutdown(cancel_futures=True)


ONE_PROCESS = LocalPool()
"""This process alone."""


def _submitted(pool: ProcessPoolExecutor, unit: Unit[Any, Any]) -> Future[Any]:
    try:
        return pool.submit(_attempt, command_words(), pickle.dumps((unit.work, unit.item)))
    except Exception as error:  # a worker died already, or the unit cannot be pickled
        future: Future[Any] = Future()
        future.set_exception(error)
        return future


def _result(future: Future[Any]) -> Any:
    try:
        return future.result()
    except BrokenProcessPool:
        return Lost(DIED)
    except Exception as error:  # it cannot be pickled or unpickled
        return Lost(f"it cannot be sent to a process: {error}")


@contextlib.contextmanager
def _worker_settings() -> Iterator[None]:
    """Let processes that start in the block inherit ``ONE_THREAD`` and a blocked SIGINT; this process gets it later."""
    before, blocks = dict(os.environ), hasattr(signal, "pthread_sigmask")
    os.environ.update(ONE_THREAD)
    if blocks:
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
        if blocks:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def _begin(values: bytes) -> None:
    """Make a fresh process a worker, which ends with its parent, even a killed one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    share(pickle.loads(values))


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _attempt(words: Sequence[str], content: bytes) -> Any:
    """Run a unit; a termination removes incomplete files before the process ends. ``words``: see ``command_of``."""
    work, item = pickle.loads(content)  # an error here is the unit's; one while the pool unpickles ends the worker
    try:
        with terminated_in_order(), command_of(words):
            return attempt(work, item)
    except SystemExit as terminated:
        os._exit(terminated.code)  # pyright: ignore[reportArgumentType]
