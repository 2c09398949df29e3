"""python -m docs.studies unseen-feeders, as a user runs it, and the score of each random feeder by itself."""

import re
from typing import Any

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.baselines import make_controller, published, rollout
from dcgrid_env.core.work.local_pool import ONE_PROCESS
from docs.studies.commands import main
from docs.studies.learning import unseen_feeders
from docs.studies.learning.feeder_by_feeder import on_each_feeder


def test_each_random_feeder_has_a_score_of_its_own():
    one: Any = next(unseen_feeders.tried(["droop-tuned", "droop-q"], ["zero-shot"], "test", 2, ONE_PROCESS))
    values: Any = published(one.scenario)
    own: Any = [unseen_feeders.feeder_scores(one, name) for name in ("droop-tuned", "droop-q")]
    assert (own[0] == 0.0).all()
    expected = (one.droop.J - one.others["droop-q"].J) / (one.droop.J - values.select((0, 1)).J)
    assert np.sort(own[1]) == pytest.approx(np.sort(expected))
    table: Any = unseen_feeders.feeders_table(one, 1)
    assert table.rows[0][3] == "0 of 2"


@pytest.mark.slow
def test_each_feeder_is_scored_over_episodes_of_its_own():
    begun, done = [], []
    driven = on_each_feeder(
        ["droop-q"], "zero-shot", "test", 2, 2, on_begin=begun.append, on_feeder=lambda: done.append(1)
    )
    assert begun == [len(driven)] == [len(done)] == [2]
    test = make_scenario("zero-shot", split="test")
    for first, on in enumerate(driven):
        assert on.first == first
        member, law = test.member(first), make_controller("droop-q", test)
        assert (on.J["droop-q"] == rollout(member, law, range(2)).costs()).all()
        assert (on.best <= on.J["droop-tuned"]).all()
        assert on.score("droop-tuned") == 0.0
    table: Any = unseen_feeders.each_table("zero-shot", ["droop-q"], driven, 2, 1)
    assert table.rows[0][4] == f"{min(on.score('droop-q') for on in driven):.2f}"


@pytest.mark.slow
def test_the_command_writes_its_page(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["--controllers", "droop-q,ieee33-weak-analytic", "--scenarios", "toy6", "--episodes", "2", "--out", "docs"]
    main(["unseen-feeders", *words])
    page = (tmp_path / "docs" / "unseen-feeders.md").read_text()
    assert page.startswith("# Feeders that were never seen\n")
    assert "| toy6 |" in page
    assert "wrote docs/unseen-feeders.md" in capsys.readouterr().out


@pytest.mark.parametrize(
    "words",
    [
        ("--each", "-1"),
        ("--each", "2", "--scenarios", "toy6"),
        ("--episodes", "1"),
        ("--worst", "0"),
        ("--controllers", ""),
        ("--worst", "-1"),
    ],
)
def test_settings_that_cannot_be_are_refused(words, capsys):
    with pytest.raises(SystemExit):
        main(["unseen-feeders", *words])
    assert re.match(rf"dcgrid: {words[0].removeprefix('--')}(:| is) ", capsys.readouterr().err)


@pytest.mark.slow
def test_a_controller_that_there_is_not_is_an_error_and_one_that_refuses_says_why(capsys):
    words = ["unseen-feeders", "--scenarios", "toy6", "--episodes", "2", "--controllers"]
    with pytest.raises(SystemExit) as raised:
        main([*words, "droop-q,nosuch"])
    said = capsys.readouterr()
    assert (raised.value.code, said.out) == (2, "")
    assert said.err.startswith("dcgrid: no controller 'nosuch'")
    main([*words, "routing-analytic"])
    said = " ".join(capsys.readouterr().out.split())
    assert "does not apply" in said
    assert "controller 'routing-analytic' cannot drive toy6" in said


@pytest.mark.slow
def test_where_every_controller_refuses_no_feeder_is_driven_by_itself(monkeypatch, capsys):
    def solved(*_: Any, **__: Any) -> None:
        raise AssertionError("hindsight was solved for no controller")

    monkeypatch.setattr("docs.studies.learning.feeder_by_feeder.hindsight", solved)
    words = ["--scenarios", "zero-shot", "--episodes", "2", "--each", "2", "--controllers", "routing-analytic"]
    main(["unseen-feeders", *words])
    said = capsys.readouterr().out
    assert "does not apply" in said
    assert "of its own" not in said
