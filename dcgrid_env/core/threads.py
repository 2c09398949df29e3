"""Rows of a batch spread over the cores of this process.

The calling thread also takes a slice, so it never waits idly for a core that it could use itself. The other threads are
a separate thread pool around kernels that release the interpreter lock. The compiler's parallel loops are not used,
because their runtime breaks in a child process created by fork, as in vectorised environments.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from itertools import pairwise

from dcgrid_env.core.compiled import compiled

ROWS_PER_THREAD = 64  # below this many rows a thread costs more than it saves
_pool: tuple[int, ThreadPoolExecutor] | None = None


def n_threads() -> int:
    """Threads used for a batch: ``DCGRID_NUM_THREADS`` or the cores that this process may run on."""
    asked = os.environ.get("DCGRID_NUM_THREADS")
    if asked:
        if not asked.isdecimal() or int(asked) < 1:
            raise ValueError(f"DCGRID_NUM_THREADS is {asked!r}; give a whole number of at least 1")
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def over_rows(work: Callable[[int, int], int], n_row: int) -> int:
    """Sum of ``work(first, last)`` over slices that together cover ``range(n_row)``, each on its own thread.

    The last slice is the caller's; an error in any slice is raised once all of them are done.
    """
    if n_row < 2 * ROWS_PER_THREAD:
        return work(0, n_row)
    parts = min(n_threads(), n_row // ROWS_PER_THREAD)
    if parts == 1:
        return work(0, n_row)
    cuts = [n_row * i // parts for i in range(parts + 1)]
    others = [_executor().submit(work, *cut) for cut in pairwise(cuts[:-1])]
    try:
        last_part = work(cuts[-2], cuts[-1])
    finally:
        wait(others)
    return last_part + sum(other.result() for other in others)


@compiled
def _nothing() -> int:
    return 0


def _executor() -> ThreadPoolExecutor:
    global _pool
    if _pool is None or _pool[0] != os.getpid():  # threads do not survive a fork
        _nothing()  # the compiler sets itself up at its first call, and two threads that make it at once break it
        _pool = (os.getpid(), ThreadPoolExecutor(max(n_threads() - 1, 1), thread_name_prefix="dcgrid"))
    return _pool[1]
