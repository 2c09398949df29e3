"""Progress bar of the commands: description, count, elapsed and remaining time."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress


def progress_bar(console: Console) -> Progress:
    """Return a progress bar, a context manager to which the caller adds tasks.

    Elapsed and remaining time exclude the time that this process spends compiling kernels.
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
