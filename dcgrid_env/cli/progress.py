"""The progress bar of the commands: what is being done, how much of it, since when and for how long yet."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress


def progress_bar(console: Console) -> Progress:
    """A context manager; its tasks are added with a description, a total and what is completed already.

    The time that this process compiles kernels counts neither as elapsed nor for the time that remains.
    """
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from dcgrid_env.core.compiled import compiling_s

    columns = (
        TextColumn("{task.description:>16}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    return Progress(*columns, TimeRemainingColumn(), console=console, get_time=lambda: time.monotonic() - compiling_s())
