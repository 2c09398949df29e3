"""Policies on other presets: the tables of the study and its command."""

import pytest

from docs.studies.commands import main
from docs.studies.learning.transfer import DOES_NOT_FIT, Cell, Row, markdown, policies_of, rows, summary, table

RESULTS = [
    Row("toy6", {"toy6-ppo": Cell(0.5, 0.5, 0.0), "ieee33-ppo": Cell(-90.0, -0.625, 60.0)}),
    Row("ieee33", {"toy6-ppo": Cell(None, None, 0.0), "ieee33-ppo": Cell(0.75, 0.5, 10.0)}),
]


def test_the_tables_say_what_is_at_home_what_does_not_fit_and_what_is_worst():
    assert table(RESULTS, "t", False).rows == (("toy6", "[0.50]", "-90.00"), ("ieee33", DOES_NOT_FIT, "[0.75]"))
    assert table(RESULTS, "t", True).rows[0] == ("toy6", "[0.50]", "-0.62")
    away, guarded, home, _ = summary(RESULTS, "t").rows
    assert away == ("other presets", "unchanged", "1", "-90.000", "-90.000", "-90.00 (ieee33-ppo on toy6)", "1", "0")
    assert guarded[5:] == ("-0.62 (ieee33-ppo on toy6)", "1", "60")
    assert home[2:5] == ("2", "0.625", "0.625")
    page = markdown([("ppo", RESULTS)], 4, "validation", "python -m docs.studies transfer")
    assert "only set the scale" in page
    assert r"| ieee33 | - | \[0.75\] |" in page


def test_policies_of_an_algorithm_are_those_that_ship():
    assert policies_of("safe", ["toy6", "ieee33-weak"]) == ["ieee33-weak-safe"]


@pytest.mark.slow
def test_a_policy_at_home_has_its_score_and_elsewhere_it_is_guarded():
    (row,) = rows(["toy6-analytic", "khodr141-analytic", "routing-analytic"], ["toy6"], 4, "test")
    at_home, away, other = row.cells.values()
    assert at_home.plain == pytest.approx(0.58, abs=0.02)
    assert at_home.under_guard == pytest.approx(at_home.plain, abs=0.01)
    assert away.plain is not None
    assert away.under_guard is not None
    assert away.plain < -50.0 < -0.5 < away.under_guard
    assert away.law_pct > 50.0
    assert other == Cell(None, None, 0.0)  # its sites have a channel route


def test_the_command(tmp_path, capsys):
    main(["transfer", "--scenarios", "toy6", "--episodes", "2", "--out", str(tmp_path)])
    assert "wrote" in capsys.readouterr().out
    assert "[0.5" in (tmp_path / "transfer.md").read_text()
    for asked, message in (
        (["--episodes", "1"], "episodes: must be at least 2, got 1"),
        (["--algorithms", "sac"], "no policy of 'sac' ships for these scenarios"),
        (["--scenarios", "toy6", "--episodes", "101"], "not seed 100: give fewer"),
        (["--scenarios", "toy6", "--split", "nosuch"], "split is 'nosuch'"),
    ):
        with pytest.raises(SystemExit):
            main(["transfer", *asked, "--out", str(tmp_path)])
        said = capsys.readouterr()
        assert message in " ".join(said.err.split())
        assert not said.out  # nor a progress bar
