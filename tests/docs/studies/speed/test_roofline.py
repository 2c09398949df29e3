"""Operations of a sweep, counted from the kernels' source, and the shares of what a core can do."""

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest

from dcgrid_env.grid import load_feeder
from docs.studies.commands import main
from docs.studies.speed.operation_counts import Figure, Figures
from docs.studies.speed.roofline import block_sweeps, counts_per_sweep


def test_operations_and_accesses_of_a_row_are_counted_and_those_of_constants_are_not():
    counts = Counter()
    x: Any = Figures(np.array([3.0, 4.0]), counts)
    factor = np.float64(2.0)
    x[0] = -np.sqrt(x[0] * x[0] + factor * factor * x[1] / 0.5) + (1.0 - x[1])
    assert x.values[0] == pytest.approx(-math.sqrt(9.0 + 32.0) - 3.0)
    assert counts == {"flops": 7, "divisions and roots": 2, "accesses": 5}
    assert isinstance(x[1], Figure)


@pytest.mark.slow
def test_a_sweep_has_the_operations_that_its_formulas_have():
    counts = counts_per_sweep()
    # Flows with the losses (4) and their sum (2), squared current (3 and a division), voltage (7), residual (2). The
    # flow of the only branch at the substation is not added to another.
    n_branch = load_feeder("ieee123").n_branch
    assert counts["ieee123"]["flops"] == 19 * n_branch - 2
    assert counts["ieee123"]["divisions and roots"] == n_branch
    feeder = load_feeder("ieee123-3ph")
    loads = np.count_nonzero(feeder.p_load_kw[: len(feeder.network.phase_load)])
    assert 0 < counts["ieee123-3ph"]["divisions and roots"] <= 2 * loads


def test_a_block_ends_with_its_last_row():
    assert block_sweeps(np.array([4, 6, 5, 5, 9]), 2) == pytest.approx((6 + 5 + 9) / 3)


@pytest.mark.slow
def test_the_command_prints_two_rows_and_refuses_too_few_points(capsys, monkeypatch):
    monkeypatch.setenv("DCGRID_NUM_THREADS", "1")
    main(["roofline", "--points", "64", "--seconds", "0.01"])
    printed = capsys.readouterr().out
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in printed.splitlines()[4:]]
    assert [row[0] for row in rows] == ["`ieee123`", "`ieee123-3ph`"]
    assert all(float(figure.replace(",", "")) > 0.0 for row in rows for figure in row[1:7])
    with pytest.raises(SystemExit):
        main(["roofline", "--points", "1"])
    assert "points" in capsys.readouterr().err
    monkeypatch.setenv("DCGRID_NUM_THREADS", "2")
    with pytest.raises(SystemExit):
        main(["roofline"])
    assert "DCGRID_NUM_THREADS" in capsys.readouterr().err
