"""The search for settings that come close to Table I."""

import json

import pytest

from dcgrid_env.apps.reproduction.load import choose_load
from dcgrid_env.apps.reproduction.study_runs import Setting
from docs.studies.commands import main
from docs.studies.paper import fit_paper
from docs.studies.paper.guess import VALUES, Distance, Guess

SETTING = Setting(choose_load("generated"), episodes=3)
GOAL = Guess(squared=True, v0_pu=1.02, q_max_share=0.1, k_p_scale=0.6, memory="one_step")


def hops(guess):
    """How many settings differ from the goal, as a distance."""
    return Distance(0.0, 0.0, float(sum(one != other for one, other in zip(guess, GOAL, strict=True))))


def test_the_search_finds_a_goal_and_tries_each_guess_once(monkeypatch):
    monkeypatch.setattr(fit_paper, "_try", hops)
    seen = []
    trials = fit_paper.search(SETTING, 150, seen.append)
    assert seen == trials
    assert len({trial.guess for trial in trials}) == len(trials) == 150
    assert trials[0].guess == Guess()
    # One pass over the settings reaches it; a second finds nothing better, and the search begins anew.
    first = next(i for i, trial in enumerate(trials) if trial.guess == GOAL)
    assert first < sum(len(values) for values in VALUES.values())
    assert trials == fit_paper.search(SETTING, 150)
    assert [trial.guess for trial in fit_paper.search(SETTING, 3)] == [trial.guess for trial in trials[:3]]


@pytest.mark.slow
def test_the_search_is_printed_and_written(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    words = ["--tries", "2", "--episodes", "2", "--trace", "generated", "--workers", "1"]
    main(["fit-paper", "--out", str(tmp_path), *words])
    assert "substation (p.u.)" in capsys.readouterr().out
    records = json.loads((tmp_path / "fit-paper.json").read_text(encoding="utf-8"))
    first, second = records["trials"]
    assert (first["squared"], second["squared"]) == (False, True)
    assert first["delay_s"] == second["delay_s"]
    assert first["total"] > second["total"]
    assert records["load"].startswith("generator")
