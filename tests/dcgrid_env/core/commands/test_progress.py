"""The clock of the progress bar."""

import io
import time

import numba
from rich.console import Console

from dcgrid_env.core.commands.progress import progress_bar
from dcgrid_env.core.compiled import compiling_s


def test_the_clock_stands_still_while_a_kernel_compiles():
    clock = progress_bar(Console(file=io.StringIO())).get_time
    real, shown, compiling = time.monotonic(), clock(), compiling_s()
    assert _sum_of_squares(3) == 5.0
    compiling = compiling_s() - compiling
    assert compiling > 0.0
    assert clock() - shown <= time.monotonic() - real - compiling + 1e-6


@numba.njit  # in no cache
def _sum_of_squares(n):
    total = 0.0
    for i in range(n):
        total += i * i
    return total
