"""A training run's folder: one training at a time, and nothing left of one that came to nothing."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from dcgrid_env.agents.training.config import Training
from dcgrid_env.agents.training.run_folder import TrainingError, open_run, read_curve

CONFIG = Training("toy6")


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_second_training_in_the_same_folder_is_refused_by_name_and_the_first_goes_on(tmp_path):
    with open_run(tmp_path / "run", CONFIG) as run:
        for resume in (False, True):
            said = f"another training \\(process {os.getpid()} on .* give another"
            with pytest.raises(TrainingError, match=said), open_run(tmp_path / "run", CONFIG, resume):
                pytest.fail("two at once")
        run.save({"x": torch.ones(2)})
    assert names(tmp_path / "run") == ["checkpoint.pt", "config.json"]


def test_checkpoints_written_at_once_do_not_meet(tmp_path, monkeypatch):
    """Two trainings in one folder once ended with "No such file: checkpoint.part"."""
    replace = Path.replace

    def meanwhile(self, target):
        monkeypatch.setattr(Path, "replace", replace)
        run.save({"x": torch.zeros(2)})
        return replace(self, target)

    with open_run(tmp_path / "run", CONFIG) as run:
        monkeypatch.setattr(Path, "replace", meanwhile)
        run.save({"x": torch.ones(2)})
        state = run.load()
    assert state is not None
    assert state["x"].tolist() == [1.0, 1.0]
    assert names(tmp_path / "run") == ["checkpoint.pt", "config.json"]


KILLED = """
import os, sys
from pathlib import Path
import torch
from dcgrid_env.agents.training.config import Training
from dcgrid_env.agents.training.run_folder import open_run
with open_run(Path(sys.argv[1]), Training("toy6")) as run:
    run.step = 7
    run.save({"x": torch.ones(2)})
    torch.save = lambda *_: os._exit(9)
    run.save({})
"""


@pytest.mark.slow
def test_a_killed_training_blocks_nobody_and_what_it_left_is_cleared(tmp_path):
    assert subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "run")], check=False).returncode == 9
    assert len(names(tmp_path / "run")) == 5  # with the lock, its note and the half of a checkpoint
    with open_run(tmp_path / "run", CONFIG, resume=True) as run:
        state = run.load()
        assert state is not None
        assert state["step"] == 7
    assert names(tmp_path / "run") == ["checkpoint.pt", "config.json"]


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_a_run_that_came_to_nothing_leaves_nothing(tmp_path, error):
    def fail(run):
        run.save({})
        raise error

    (tmp_path / "there").mkdir()
    for folder in (tmp_path / "made" / "run", tmp_path / "there"):
        with pytest.raises(error), open_run(folder, CONFIG):
            raise error
    assert names(tmp_path) == ["there"]
    assert not names(tmp_path / "there")
    with pytest.raises(error), open_run(tmp_path / "there", CONFIG) as run:
        fail(run)
    assert names(tmp_path / "there") == ["checkpoint.pt", "config.json"]


def test_a_refused_resumption_leaves_the_run_as_it_is(tmp_path):
    with open_run(tmp_path, CONFIG):
        pass
    before = (tmp_path / "config.json").read_bytes()
    with (
        pytest.raises(TrainingError, match="seed was 0 and is 1 now"),
        open_run(tmp_path, Training("toy6", seed=1), True),
    ):
        pass
    with pytest.raises(TrainingError, match="holds a run already"), open_run(tmp_path, CONFIG):
        pass
    assert (tmp_path / "config.json").read_bytes() == before
    assert json.loads(before)["scenario"] == "toy6"


def test_a_damaged_configuration_is_refused_on_one_line(tmp_path):
    with open_run(tmp_path, CONFIG):
        pass
    (tmp_path / "config.json").write_text("[]")
    message = r"config.json: is no configuration of a training run; delete the folder"
    with pytest.raises(TrainingError, match=message), open_run(tmp_path, CONFIG, True):
        pass


def test_a_resumption_without_a_checkpoint_says_that_it_begins_anew_and_goes_on_from_the_next(tmp_path, capsys):
    """The first start of a job, its restart after a kill before the first checkpoint, and the one after that."""
    folder = tmp_path / "run"
    for _ in range(2):
        with open_run(folder, CONFIG, resume=True) as run:
            assert run.load() is None
        assert capsys.readouterr().out == f"{folder}: no checkpoint to resume from, training begins anew\n"
    with open_run(folder, CONFIG, resume=True) as run:
        run.save({})
        assert run.load() is not None
    with open_run(tmp_path / "plain", CONFIG) as run:
        assert run.load() is None
    assert capsys.readouterr().out == ""


def test_rows_after_the_checkpoint_are_dropped(tmp_path):
    with open_run(tmp_path, CONFIG) as run:
        for step in (1, 2):
            run.step = step
            run.record({"J": step / 3, "K": float("nan")})
            if step == 1:
                run.save({})
    with open_run(tmp_path, CONFIG, resume=True) as run:
        run.load()
        assert [row["step"] for row in read_curve(tmp_path)] == [1]
        run.step = 2
        run.record({"J": 2 / 3, "K": 0.0})
    assert [(row["step"], row["J"]) for row in read_curve(tmp_path)] == [(1, 1 / 3), (2, 2 / 3)]
    (tmp_path / "checkpoint.pt").unlink()
    with open_run(tmp_path, CONFIG, resume=True) as run:
        assert run.load() is None
    assert read_curve(tmp_path) == []
