"""Execution of a unit in a worker: error handling, shared values and orderly termination."""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

from dcgrid_env.core.signals import raising
from dcgrid_env.core.versions import command_of
from dcgrid_env.core.work.unit import Lost

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "DCGRID_NUM_THREADS")
"""Environment variables for the number of threads of numerical libraries; 1 in a worker."""

Item = TypeVar("Item")
Result = TypeVar("Result")

_KEY = ""
"""Name under which a worker of a cluster keeps whose values it has."""
_values: dict[str, Any] = {}
_busy = False


def shared(name: str, default: object = None) -> Any:
    """A value that the units of this run share, by its name; ``default`` where there is none."""
    return _values.get(name, default)


@contextlib.contextmanager
def sharing(values: Mapping[str, Any]) -> Iterator[None]:
    """Let units that run in the block have these values."""
    before = dict(_values)
    _values.clear()
    _values.update(values)
    try:
        yield
    finally:
        _values.clear()
        _values.update(before)


def share_once(key: str, values: Callable[[], Mapping[str, Any]]) -> None:
    """Let all that this process does from now on have these values, unless it has those of ``key`` already."""
    if _values.get(_KEY) != key:
        _values.clear()
        _values.update(values(), **{_KEY: key})


def attempt(work: Callable[[Item], Result], item: Item) -> Result | Lost:
    """The work of a unit; in place of its result what it raised. A worker that is terminated meanwhile ends here."""
    global _busy
    before, _busy = _busy, True
    try:
        return work(item)
    except (Exception, SystemExit) as error:  # a user's own code may raise the latter, which is a failure of that code
        return _lost(error)
    finally:
        _busy = before


def _lost(error: BaseException) -> Lost:
    """Return the report of an error; an error that cannot be pickled is replaced by its description."""
    reason = " ".join(str(error).split())
    if not isinstance(error, ValueError | OSError) or not reason:
        reason = f"{type(error).__name__}: {reason}" if reason else type(error).__name__
    kept: Exception = error if isinstance(error, Exception) else RuntimeError(reason)
    try:
        pickle.loads(pickle.dumps(kept))
    except Exception:
        kept = RuntimeError(reason)
    kept.add_note("".join(traceback.format_exception(error)))
    return Lost(reason, kept)


def begin_process(values: bytes) -> None:
    """Make a fresh process a worker: Ctrl-C is left to the parent, with which it ends; the shared values are there."""
    import threading

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # not inherited everywhere
    signal.signal(signal.SIGTERM, _end_worker)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _values.update(pickle.loads(values))


def _end_with_parent() -> None:
    """Wait for the parent's sentinel and exit, because a killed parent cannot notify its workers."""
    from multiprocessing import parent_process
    from multiprocessing.connection import wait

    parent = parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)


def attempt_in_process(work: Callable[[Item], Result], item: Item, words: Sequence[str]) -> Result | Lost:
    """Run ``attempt`` in a separate process; a termination removes partly written files before the process ends.

    ``words`` are those of the command that runs, see ``command_of``.
    """
    try:
        with command_of(words):
            return attempt(work, item)
    except Terminated as terminated:
        os._exit(terminated.args[0])


def _end_worker(number: int, frame: object) -> None:
    if _busy:
        raise Terminated(128 + number)
    os._exit(128 + number)


@contextlib.contextmanager
def terminated_in_order() -> Iterator[None]:
    """Let SIGTERM end the process by an exception, so that what is half written goes, as under Ctrl-C."""
    try:
        with raising(signal.SIGTERM, Terminated(128 + signal.SIGTERM)):
            yield
    except Terminated as terminated:
        raise SystemExit(terminated.args[0]) from None


class Terminated(BaseException):
    """SIGTERM has come; no SystemExit, which a user's own code may raise and which is then a failure of that code."""
