"""Entries of the leaderboard: what can be submitted. Hostile or changed folders are refused."""

import json
import os
import random
from pathlib import Path

import numpy as np
import pytest

from dcgrid_env.agents import Network, Policy
from dcgrid_env.agents.policy.policy import FOLDER
from dcgrid_env.apps.leaderboard.entries import Submission, SubmissionError, read_record
from dcgrid_env.apps.leaderboard.rounds import read_report, verify
from dcgrid_env.apps.leaderboard.submit_command import submit
from dcgrid_env.cli.main import main
from dcgrid_env.core.files import sha256_of
from helpers.fuzzing import mutated_bytes
from helpers.leaderboard_entries import change, error_line

PRESET, POLICY = "toy6", FOLDER / "toy6-analytic.safetensors"
CODE = """
class Mine:
    def __init__(self, q=0.0):
        self.q = q

    def reset(self, env_info):
        self.n = 4

    def act(self, observations):
        return [[1.0, self.q, self.q, self.q]] * len(observations)
"""


def test_an_entry_is_data(entry):
    submission = read_record(entry / "submission.json", Submission)
    assert (submission.policy, submission.scenario, submission.learned_on) == ("policy.safetensors", PRESET, "train")
    files = {path.name: sha256_of(path) for path in entry.iterdir() if path.stem == "policy"}
    assert submission.files == files
    assert set(files) == {"policy.safetensors", "policy.json"}


@pytest.mark.parametrize(
    ("policy", "information"),
    [
        (f"guarded:{POLICY}", "local + sensitivities"),
        ("dcgrid_env.baselines:ConstantQ(q_share=0.2)", "local"),
    ],
)
def test_guarded_policies_and_laws_with_arguments_need_no_trust(policy, information, tmp_path):
    folder = tmp_path / "entry"
    _, published = submit(policy, "x", folder, scenario=PRESET, episodes=2)
    _, report = verify(folder, 7)
    assert (published.seeds, report.information) == ((0, 1), information)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"format": 2, "scope": "local"}, "format: input should be 3"),
        ({"name": "a\n| b"}, "name is 'a\\n| b'; give one line"),
        ({"name": "\x1b[2J"}, "name is '\\x1b[2J'; give one line"),
        ({"paper": "x" * 81}, "give one line of 1 to 80 letters"),
        ({"scenario": "mine"}, "scenario is 'mine'; the leaderboard has the presets"),
        ({"scenario": "ieee33"}, "that of ieee33 is "),
        ({"scenario_hash": "0" * 16}, "scenario_hash is '0000000000000000', that of toy6 is "),
        ({"files": {}}, "policy is 'policy.safetensors', which does not fit its files []"),
        ({"files": {"../policy.json": "0"}}, "which does not fit its files ['../policy.json']"),
        ({"policy": "toy6-analytic"}, "policy is 'toy6-analytic', which does not fit its files"),
        ({"policy": "x" * 10_000_000}, "has more than 1 MiB"),
        ({"learned_on": "luck"}, "learned_on: "),
        ({"more\x1b\n": 1}, "more\\x1b\\n: "),
    ],
)
def test_a_changed_submission_is_one_line_and_keeps_the_report(fields, message, copied, capsys):
    before = (copied / "verified.json").read_bytes()
    change(copied / "submission.json", **fields)
    line = error_line(capsys, "verify", copied, "--round-seed", 1)
    assert message in line
    assert "submission.json" in line
    assert (copied / "verified.json").read_bytes() == before


@pytest.mark.parametrize(
    "policy",
    [
        "MARK.py:Mine", "guarded:MARK.py:Mine", "MARK:Mine", "controller.py:Mine", ".safetensors", "guarded:",
        "json:loads",
        "dcgrid_env.baselines:find_controller('MARK.py:Mine')", "dcgrid_env.baselines.registry:Droop",
        "dcgrid_env.baselines:Mpc(horizon=1000000)", "dcgrid_env.baselines:Droop(" + "(" * 200, "MARK.zip",
    ],
)  # fmt: skip
@pytest.mark.parametrize("files", [(), ("policy.safetensors", "policy.json"), ("controller.py",)])
def test_no_policy_text_runs_code_without_trust(policy, files, copied, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for path in (tmp_path / "mark.py", copied / "controller.py"):
        path.write_text(f"import pathlib\npathlib.Path({str(tmp_path / 'ran')!r}).touch()\n{CODE}")
    policy = policy.replace("MARK", "mark" if policy.startswith("MARK:") else str(tmp_path / "mark"))
    change(copied / "submission.json", policy=policy, files={name: sha256_of(copied / name) for name in files})
    line = error_line(capsys, "verify", copied, "--round-seed", 1)
    assert "submission.json: " in line
    assert not (tmp_path / "ran").exists()


def test_files_that_would_exhaust_the_process_are_refused(copied, capsys):
    weights, card, record = (copied / name for name in ("policy.safetensors", "policy.json", "submission.json"))
    text, many = record.read_text(), json.dumps({f"{i}": i for i in range(60_000)})
    os.truncate(weights, 2**40)  # without blocks on the disk
    assert "policy.safetensors: has 1048576 MiB; give" in error_line(capsys, "verify", copied, "--round-seed", 1)
    card.unlink()
    os.mkfifo(card)
    weights.write_bytes(POLICY.read_bytes())
    assert "policy.json is a pipe" in error_line(capsys, "verify", copied, "--round-seed", 1)
    for hostile in ("[" * 1_000_000, '{"format":' * 100_000, "9" * 1_000_000, many, "\x00", text.replace("3", "1e999")):
        record.write_text(hostile)
        assert "submission.json: " in error_line(capsys, "verify", copied, "--round-seed", 1)
    record.unlink()
    record.symlink_to("/dev/zero")
    assert "submission.json is a device" in error_line(capsys, "verify", copied, "--round-seed", 1)


def test_changed_and_missing_files_are_named(copied, capsys):
    weights, verifying = copied / "policy.safetensors", ("verify", copied, "--round-seed", 1)
    content = bytearray(weights.read_bytes())
    content[-1] ^= 1
    weights.write_bytes(content)
    assert "policy.safetensors: sha256 is " in error_line(capsys, *verifying)
    change(copied / "submission.json", files={f.name: sha256_of(f) for f in (weights, copied / "policy.json")})
    assert "policy.safetensors: its contents do not have the sha256" in error_line(capsys, *verifying)
    Policy({"joint": Network([(np.zeros((23, 4)), np.zeros(4))])}).save(weights)
    change(copied / "submission.json", files={f.name: sha256_of(f) for f in (weights, copied / "policy.json")})
    assert "submission is '" in error_line(capsys, "verify", copied, "--again")
    weights.unlink()
    assert "policy.safetensors: is missing" in error_line(capsys, *verifying)
    (copied / "submission.json").unlink()
    assert "give a folder that dcgrid submit wrote" in error_line(capsys, *verifying)


@pytest.mark.parametrize("file", ["submission.json", "verified.json", "card and weights"])
@pytest.mark.slow
def test_a_damaged_folder_is_refused_by_its_file_or_reads_as_the_same(file, copied):
    (same, _), refused, rng = read_report(copied), 0, random.Random(3)
    names = [file] if file.endswith(".json") else sorted(same.files)
    contents = {name: (copied / name).read_bytes() for name in names}
    for _ in range(300):
        for name, content in mutated_bytes(contents, rng).items():
            (copied / name).write_bytes(content)
        error = None
        try:
            submission, _ = read_report(copied)
            assert submission == same  # costs of a report may differ: they are not hashed
        except SubmissionError as refusal:
            error = str(refusal)
        if error is not None:
            refused += 1
            assert error.startswith(str(copied))
            assert error.isprintable()  # one line
    assert refused > 100


@pytest.mark.slow
def test_code_runs_only_with_trust(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(CODE)
    submitting = (
        "submit",
        "mine.py:Mine(q=0.1)",
        "--name",
        "mine",
        "--scenario",
        PRESET,
        "--episodes",
        "2",
        "--out",
        "made",
    )
    main([*submitting])
    assert {path.name for path in Path("made").iterdir()} == {"controller.py", "submission.json"}
    assert read_record(Path("made/submission.json"), Submission).policy == "controller.py:Mine(q=0.1)"
    assert "read controller.py, and run the command with --trust in a container" in error_line(
        capsys, "verify", "made", "--round-seed", 1
    )
    main(["verify", "made", "--trust", "--round-seed", "1"])
    assert "information: local" in capsys.readouterr().out
    assert read_report(Path("made"))[1].policy == ""  # without running the code
    assert "which is there and not empty" in error_line(capsys, *submitting)
    with Path("made/controller.py").open("a") as file:
        file.write("print('more')\n")
    assert "controller.py: sha256 is " in error_line(capsys, "verify", "made", "--trust", "--round-seed", 1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("droop-tuned", "--name", "x"), "was not trained on a preset; pass --scenario"),
        (("nope", "--name", "x", "--scenario", PRESET), "nope"),
        (("json:loads", "--name", "x", "--scenario", PRESET), "give path/to/file.py:Class, whose file goes"),
        (("none.py:Mine", "--name", "x", "--scenario", PRESET), "there is no file none.py"),
        (("none.safetensors", "--name", "x", "--scenario", PRESET), "there is no file none.safetensors"),
        (("model.zip", "--name", "x", "--scenario", PRESET), "not a zip that Stable-Baselines3 wrote"),
        (("toy6-analytic", "--name", "a\nb"), "name is 'a\\nb'; give one line"),
        (("toy6-analytic", "--name", "x", "--episodes", "101"), "hindsight is published for 100 episodes"),
        (("toy6-analytic", "--name", "x", "--scenario", "mine.toml"), "scenario is 'mine.toml'; the leaderboard has"),
        ((f"json:loads('{'x' * 300}')", "--name", "x"), "policy has 314 letters; give at most 300"),
    ],
)
def test_what_cannot_be_entered_is_one_line(arguments, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("model.zip").touch()
    assert message in error_line(capsys, "submit", *arguments)
    assert not Path("results").exists()


def test_submit_warns_below_the_best_rule_without_measurements(tmp_path, capsys):
    main(
        ["submit", "none", "--name", "x", "--scenario", "ieee33-weak", "--episodes", "2", "--out", str(tmp_path / "x")]
    )
    assert "which uses no measurements" in " ".join(capsys.readouterr().out.split())
    assert json.loads((tmp_path / "x" / "submission.json").read_text())["policy"] == "none"
