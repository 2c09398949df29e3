"""The table of sizes: its feeders, its figures and its command."""

import json

import numpy as np
import pytest

from dcgrid_env.powerflow import distflow, solve_unbalanced
from docs.studies.commands import main
from docs.studies.speed.size_table import COLUMNS
from docs.studies.speed.synthetic_feeders import DROP_PU, LOAD_KW, balanced_feeder, three_phase_feeder


@pytest.mark.parametrize("n", [50, 500])
@pytest.mark.parametrize("chain", [False, True])
def test_a_synthetic_feeder_carries_its_load_at_the_same_drop(n, chain):
    feeder = balanced_feeder(n, chain=chain)
    assert feeder.n_bus == n
    assert feeder.p_load_kw.sum() == pytest.approx(LOAD_KW)
    solution = distflow(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    assert solution.converged
    assert feeder.v0_pu - solution.v_pu.min() == pytest.approx(DROP_PU, rel=0.15)
    assert (balanced_feeder(n, chain=chain).r_ohm == feeder.r_ohm).all()


def test_a_synthetic_three_phase_feeder_has_as_many_nodes_and_a_solution():
    feeder = three_phase_feeder(300)
    assert feeder.n_node == 300
    assert set(map(len, feeder.bus_phases)) == {1, 3}
    solution = solve_unbalanced(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    assert solution.converged
    assert 0.9 < solution.v_pu.min() < 1.015
    assert np.ptp(solution.v_pu) > 0.005


@pytest.mark.slow
def test_the_command_prints_and_writes_a_row_for_each_feeder(tmp_path, capsys):
    main(
        [
            "speed-sizes",
            "--buses",
            "40",
            "--three-phase-nodes",
            "--seconds",
            "0.02",
            "--json",
            str(tmp_path / "sizes.json"),
        ]
    )
    assert "flows/s" in capsys.readouterr().out
    (row,) = json.loads((tmp_path / "sizes.json").read_text())["rows"]
    assert row["feeder"] == "balanced 40"
    assert set(COLUMNS) | {"feeder"} == set(row)
    assert row["batch_per_s"] > row["one_per_s"] > 100.0


def test_a_size_that_cannot_be_is_refused(capsys):
    with pytest.raises(SystemExit):
        main(["speed-sizes", "--buses", "2"])
    assert "give sizes of at least 20" in capsys.readouterr().err
