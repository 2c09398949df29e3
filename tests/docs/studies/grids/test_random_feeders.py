"""The command that holds random feeders against published ones."""

import pytest

from dcgrid_env.grid.random_feeders.styles import STYLES
from docs.studies.commands import main
from helpers.places import ROOT

PAGE = (ROOT / "docs" / "random-feeders.md").read_text(encoding="utf-8")


def test_a_table_for_each_style_with_the_figures_of_the_page(capsys):
    main(["random-feeders", "--draws", "3", "--n-bus", "20"])
    printed = capsys.readouterr().out
    rows = [line.rsplit("|", 2)[0] for line in printed.splitlines() if line.startswith("| ") and " .. " in line]
    assert len(rows) >= 11 * len(STYLES)
    assert all(row in PAGE for row in rows)  # what is published; the draws are others
    assert all(f"{style}: " in printed for style in STYLES)


@pytest.mark.parametrize("words", [["--draws", "0"], ["--n-bus", "5"]])
def test_a_setting_that_cannot_be_is_refused(words, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["random-feeders", *words])
    assert ended.value.code == 2
    assert "give at least 1 and at least 10" in capsys.readouterr().err
