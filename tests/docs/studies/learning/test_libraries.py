"""The table of libraries: its trainings, its file, and the page that shows it."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from docs.studies.commands import main
from docs.studies.learning import libraries
from docs.studies.learning.libraries import DATA, Library, Setting, records_in, score_of, table
from docs.studies.learning.library_batches import Outcome
from docs.studies.learning.library_loops import initialise
from docs.studies.learning.scored import droop_on_test
from helpers.places import ROOT


def by_droop(on: Setting) -> Outcome:
    """The costs of the tuned droop, a little lower with each seed."""
    return Outcome(1.0, droop_on_test(on.scenario, on.episodes).J - 0.01 * on.seed)


def failing(on: Setting) -> Outcome:
    """Fail as a library does."""
    raise RuntimeError(f"diverged with seed {on.seed}")


@pytest.fixture
def droop_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(libraries.LIBRARIES, "droop", Library("numpy", partial(by_droop), 40, 2))


def run(out: Path, *words: str) -> None:
    """Run the command on toy6 with few episodes."""
    main(["libraries", "--scenarios", "toy6", "--episodes", "4", "--out", str(out), *words])


@pytest.mark.usefixtures("droop_library")
def test_trainings_are_added_to_the_file_once_and_replaced_by_other_steps(tmp_path, capsys):
    out = tmp_path / "made" / "libraries.json"
    run(out, "--library", "droop", "--seeds", "2")
    run(out, "--library", "droop", "--rewards", "shared", "--seeds", "1", "--steps", "80")
    before = out.read_text()
    run(out, "--library", "droop", "--seeds", "2")
    assert out.read_text() == before
    run(out, "--library", "droop", "--seeds", "1", "--rewards", "shared", "--steps", "120")
    records = records_in(out)
    assert [(r["reward"], r["seed"], r["steps"]) for r in records] == [
        ("difference", 0, 40),
        ("difference", 1, 40),
        ("shared", 0, 120),
    ]
    row = capsys.readouterr().out.splitlines()[-2].split(" | ")
    assert row[3:7] == ["`toy6`", "difference", "40", "2"]
    assert records[0]["J_validation"] == 1.0
    assert records[0]["peak_mib"] > 10
    assert score_of(records[:1]).value == pytest.approx(0.0, abs=1e-5)
    assert score_of(records[:2]).value == pytest.approx(0.5 * score_of(records[1:2]).value, abs=1e-4)


@pytest.mark.usefixtures("droop_library")
def test_a_training_that_fails_leaves_no_record_and_the_others_go_on(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(libraries.LIBRARIES, "fails", Library("numpy", failing, 40, 2))
    out = tmp_path / "libraries.json"
    with pytest.raises(SystemExit):
        run(out, "--library", "fails,droop", "--seeds", "2")
    assert [(r["library"], r["seed"]) for r in records_in(out)] == [("droop", 0), ("droop", 1)]
    printed = capsys.readouterr()
    assert "fails on toy6, difference, seed 1: RuntimeError('diverged with seed 1')" in printed.err
    assert "library: 2 trainings failed" in printed.err
    assert "| droop |" in printed.out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--library", "sb3-ppo,nope"), "library: 'nope' is unknown; choose from sb3-ppo"),
        (("--library", "sb3-ppo", "--rewards", "team"), "rewards: 'team' is unknown; choose from difference, local"),
        (("--seeds", "0"), "seeds: must be at least 1, got 0"),
        (("--library", "sb3-ppo", "--steps", "0"), "steps: must be at least 1, got 0"),
    ],
)
def test_invalid_settings_are_refused(words, message, tmp_path, capsys):
    with pytest.raises(SystemExit):
        run(tmp_path / "libraries.json", *words)
    assert message in capsys.readouterr().err.replace("\n", " ")


def test_a_library_that_is_not_installed_is_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(libraries.LIBRARIES, "absent", Library("not-on-any-index", partial(by_droop), 40, 2))
    with pytest.raises(SystemExit):
        run(tmp_path / "libraries.json", "--library", "absent")
    assert "library: absent needs not-on-any-index, which is not installed; see" in capsys.readouterr().err


def test_another_file_is_refused(tmp_path):
    other = tmp_path / "other.json"
    other.write_text("{}")
    with pytest.raises(ValueError, match=r"out: .*other.json has no trainings of this study .* choose another --out"):
        records_in(other)


@pytest.mark.parametrize(
    ("name", "scenario"),
    [
        ("sb3-ppo", "toy6"),
        ("sb3-sac", "ieee33-weak"),
        ("sb3-td3", "toy6"),
        ("sb3-contrib-tqc", "toy6"),
        ("sb3-contrib-recurrent-ppo", "toy6"),
        ("cleanrl-ppo", "ieee33-weak"),
        ("skrl-ppo", "toy6"),
        ("torchrl-ppo", "ieee33-weak"),
        ("benchmarl-mappo", "toy6"),
        ("benchmarl-maddpg", "toy6"),
    ],
)
@pytest.mark.slow
def test_a_library_trains_and_is_tested(name, scenario):
    library = libraries.LIBRARIES[name]
    pytest.importorskip(library.package.replace("-", "_"))
    tested = library.train(Setting(scenario, "difference", 0, 480, 2, 2))
    assert np.isfinite([tested.validation, *tested.J]).all()
    assert tested.J.shape == (2,)
    assert library.glue_lines > 10


def test_lines_of_glue_are_counted_without_docstrings_and_without_the_library(tmp_path, monkeypatch):
    text = '''
import not_installed

class One:
    """Two
    lines."""

    def method(self):
        """One line."""

        return "value"

def other(): return 1
'''
    (tmp_path / "glue_of_a_test.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    assert libraries.code_lines("glue_of_a_test", "One") == 3
    assert libraries.code_lines("glue_of_a_test", "One", "other") == 4
    for library in libraries.LIBRARIES.values():
        assert 10 < library.glue_lines < 150


def test_orthogonal_weights_have_their_gains():
    layers = nn.Linear(3, 8), nn.Linear(8, 2)
    initialise(nn.Sequential(layers[0], nn.Tanh(), layers[1]), 0.01)
    first, last = (layer.weight.detach() for layer in layers)
    torch.testing.assert_close(first.T @ first, 2.0 * torch.eye(3), atol=1e-5, rtol=0.0)
    torch.testing.assert_close(last @ last.T, 1e-4 * torch.eye(2), atol=1e-8, rtol=0.0)
    assert not layers[0].bias.detach().any()


def test_a_library_that_cannot_train_on_a_reward_is_one_line():
    on = Setting("toy6", "shared", 0, 480, 2, 2)
    with pytest.raises(ValueError, match="reward: cleanrl-ppo is written for a discount of 0, not for 'shared'; use"):
        libraries.LIBRARIES["cleanrl-ppo"].train(on)


@pytest.mark.slow
def test_the_page_shows_the_table_of_the_file():
    records = records_in(ROOT / DATA)
    assert json.loads((ROOT / DATA).read_text())["trainings"] == records
    assert table(records) in (ROOT / "docs" / "rl-libraries.md").read_text()
