"""Long runs: the figures of a row, and a run that is caught."""

import numpy as np
import pytest

from dcgrid_env import PRESETS
from docs.studies.commands import main
from docs.studies.speed.soak import _row


@pytest.mark.slow
def test_the_command_prints_a_row_for_each_run(capsys):
    main(["soak", "--steps", "5120", "--resets", "10", "--days", "1"])
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[0] for row in rows][1:-1] == [f"resets of `{preset}`" for preset in PRESETS]
    assert [row[1] for row in (rows[0], rows[1], rows[-1])] == ["5,120", "10", "1,440"]
    assert {row[2] for row in rows} == {"0"}


def test_a_figure_that_is_not_finite_is_counted_and_memory_that_grows_is_seen():
    kept = []

    def step(i):
        kept.append(np.ones(200_000))
        return np.array([0.0, np.nan if i == 7 else 1.0]), 0.0, {"text": "none"}

    steps, wrong, early, late, *_ = _row(step, 100, 1)
    assert (steps, wrong) == ("100", "1")
    grown_mib = float(late.replace(",", "")) - float(early.replace(",", ""))
    assert grown_mib == pytest.approx(0.8 * 100 * 1.6e6 / 2**20, rel=0.2)


def test_a_setting_out_of_bounds_is_refused(capsys):
    with pytest.raises(SystemExit):
        main(["soak", "--days", "0"])
    assert "days" in capsys.readouterr().err
