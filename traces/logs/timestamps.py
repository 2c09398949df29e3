"""Dates and times as logs write them: `2023/11/16 18:17:03.979`, `2023-11-16T18:15:46.6805900`."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.traces.checks import TraceError

TIMESTAMP = r"(?:19|20)\d\d[-/]\d\d[-/]\d\d[ T]\d\d:\d\d:\d\d(?:\.\d{1,9})?"
"""Pattern without groups; years whose nanoseconds fit 64 bits."""


def nanoseconds(cells: Sequence[str], where: Callable[[int], str]) -> NDArray[np.int64]:
    """Times since 1970 on the log's own clock, (n,) int64, ns.

    Parameters
    ----------
    cells : texts that match TIMESTAMP.
    where : index -> text that begins the message, for example "file.csv, line 7".

    Raises
    ------
    TraceError
        For a date or time that does not exist, such as a 30th of February.
    """
    dashed = [cell.replace("/", "-") for cell in cells]
    try:
        return np.array(dashed, dtype="datetime64[ns]").astype(np.int64)
    except ValueError:
        for i, cell in enumerate(dashed):
            try:
                np.datetime64(cell, "ns")
            except ValueError:
                raise TraceError(f"{where(i)}: there is no time {cells[i]!r}; repair the line") from None
        raise
