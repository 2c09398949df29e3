"""Restrict torch to one thread while batches of tensors step and are differentiated.

Otherwise torch's threads spin between operations on cores that the threads of the power flow need. The operations are
so small that torch gains nothing from a second thread (docs/decisions/0023-threads.md). The program's setting is
restored after every call, which takes a third of a microsecond. Only modules that receive torch tensors import this
one, so torch is already loaded.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Run torch's operations on one thread."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def rest_of_backward_on(threads: int) -> None:
    """Run what is left of the derivative that is being computed on as many threads; to be called from a ``backward``.

    The setting is put back when the whole derivative is done, or an error has ended it.
    """
    before = torch.get_num_threads()
    if before == threads:
        return

    def done() -> None:
        put_back()

    # After an error the engine drops its callbacks without a call: the setting is put back as this one goes.
    put_back = weakref.finalize(done, torch.set_num_threads, before)
    put_back.atexit = False
    engine: Any = torch.autograd.Variable._execution_engine  # pyright: ignore[reportAttributeAccessIssue]
    engine.queue_callback(done)
    torch.set_num_threads(threads)
