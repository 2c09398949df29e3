"""Rounds of the leaderboard: fresh episodes that all entries share, reports, their repetition and the page's table."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dcgrid_env import PRESETS
from dcgrid_env.apps.leaderboard.entries import SubmissionError
from dcgrid_env.apps.leaderboard.rounds import FIRST_SEED, read_report, round_seeds, verify, verify_again
from dcgrid_env.apps.leaderboard.submit_command import submit
from dcgrid_env.baselines.score import saved
from dcgrid_env.cli.main import main
from docs.studies.commands import main as studies
from docs.studies.publishing.leaderboard import FOLDER, Listed, all_listed, tables
from helpers.leaderboard_entries import change, error_line


def test_the_seeds_of_a_round_follow_from_its_number():
    seeds = round_seeds(7, 1024)
    assert seeds[:2] == (3085237330503497560, 610735763743393210)  # or published rounds cannot be repeated
    assert seeds[:256] == round_seeds(7, 256)
    assert len({*seeds, *round_seeds(8, 1024)}) == 2048
    assert min(seeds) >= FIRST_SEED  # published episodes have the seeds 0 to 99
    assert max(seeds) < 2**62


def test_all_entries_of_a_round_run_on_the_same_episodes(entry, named, tmp_path):
    reports = [read_report(folder)[1] for folder in (entry, named)]
    assert reports[0].J == reports[1].J  # the same policy, as a file and by its name
    assert reports[0].J_droop == reports[1].J_droop
    value, low, high = reports[0].saved_pct
    assert low < value < high
    assert value == pytest.approx(100 * (1 - np.mean(reports[0].J) / np.mean(reports[0].J_droop)))
    submit("constant-q-tuned", "constant", tmp_path / "x", scenario="toy6", episodes=2)
    verify(tmp_path / "x", 8)
    assert read_report(tmp_path / "x")[1].J_droop != reports[0].J_droop
    with pytest.raises(SubmissionError, match=r"round_seed and number of episodes are .8, 256.* other reports have"):
        all_listed([entry, tmp_path / "x"])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ((), "round_seed: must be a number, or use --again to repeat a report, got None"),
        (("--again", "--round-seed", 1), "got 1 and --again"),
        (("--round-seed", 1, "--episodes", 255), "episodes: must be from 256 to 1024, got 255"),
        (("--round-seed", 1, "--episodes", 1025), "episodes: must be from 256 to 1024, got 1025"),
        (("--round-seed", -1), "round_seed: must be at least 0, got -1"),
        (("--again", "--episodes", 257), "episodes: must be at most 256"),
    ],
)
def test_rounds_of_few_episodes_are_refused(options, message, copied, capsys):
    before = (copied / "verified.json").read_bytes()
    assert message in error_line(capsys, "verify", copied, *options)
    assert (copied / "verified.json").read_bytes() == before


def test_a_report_can_be_repeated(copied, capsys):
    main(["verify", str(copied), "--again", "--episodes", "8"])
    assert "8 episodes agree with the report; nothing was written" in " ".join(capsys.readouterr().out.split())
    report = json.loads((copied / "verified.json").read_text())
    costs = [0.999 * cost for cost in report["J"]]
    change(copied / "verified.json", J=costs, saved_pct=saved(costs, report["J_droop"]))
    read_report(copied)  # consistent, but not what the policy achieves
    with pytest.raises(SubmissionError, match="the mean of J over the first 8 episodes is"):
        verify_again(copied, 8)


@pytest.mark.parametrize(
    ("file", "fields", "message"),
    [
        ("verified.json", {"saved_pct": [99.0, 98.0, 100.0]}, r"saved_pct is \(99.0, 98.0, 100.0\), that of its costs"),
        ("verified.json", {"J": [0.1] * 255}, "J: tuple should have at least 256 items"),
        ("verified.json", {"J": [0.1] * 100_000}, "J: tuple should have at most 1024 items"),
        ("verified.json", {"J": [0.1] * 257}, "J_droop has 256 costs, J has 257"),
        ("verified.json", {"J_droop": [0.0] * 256}, "J_droop.0: input should be greater than"),
        ("verified.json", {"J_droop": [1e308] * 256}, "J_droop.0: input should be less than"),
        ("verified.json", {"reference": "Droop(k_p_mw_per_pu=9.0)"}, "reference is 'Droop.*, now .Droop"),
        ("verified.json", {"policy": "0" * 64}, "policy is '0000"),
        ("verified.json", {"delay_mean_s": float("nan")}, "delay_mean_s: input should be a finite number"),
        ("verified.json", {"format": 2, "signature": ""}, "format: input should be 3"),
        ("submission.json", {"name": "other"}, "submission is '"),
        ("submission.json", {"learned_on": "nothing"}, "submission is '"),
    ],
)
def test_a_changed_report_is_not_listed(file, fields, message, copied):
    change(copied / file, **fields)
    with pytest.raises(SubmissionError, match=message):
        all_listed([copied])


def test_an_entry_without_report_or_of_other_weights_is_not_listed(copied, named, monkeypatch):
    (copied / "verified.json").unlink()
    with pytest.raises(SubmissionError, match="run dcgrid verify on the folder"):
        all_listed([copied])
    monkeypatch.setattr("dcgrid_env.apps.leaderboard.rounds.policy_sha256", lambda _: "0" * 64)
    with pytest.raises(SubmissionError, match=r"policy is 'bc7ead.*, now '0000"):
        all_listed([named])


def test_folders_are_listed_and_names_are_unique(entry, named, tmp_path, capsys):
    for folders in ([entry, named], [entry.parent, named.parent]):  # folders, and folders of folders
        studies(["leaderboard", *map(str, folders)])
        assert capsys.readouterr().out == "2 entries can be listed\n"
    twice = shutil.copytree(entry, tmp_path / "twice")
    assert "also has the name 'analytic' on toy6" in error_line(capsys, "leaderboard", entry, twice, run=studies)


def test_groups_and_texts_of_the_tables(entry):
    submission, report = read_report(entry)
    text = tables(
        [
            Listed(replace(submission, name="a|b"), report),
            Listed(replace(submission, files={"controller.py": ""}, paper="a paper"), report),
            Listed(submission, replace(report, information="local + <b>", saved_pct=(1.0, 0.0, 1.1))),
            Listed(replace(submission, learned_on="test"), report),
        ]
    ).replace("\u00a0", " ")
    main_table, title, of_test = text.partition("### Learned or tuned on the test split\n")
    assert (main_table.count("| toy6 |"), of_test.count("| toy6 |"), bool(title)) == (3, 1, True)
    assert text.startswith("Round 7, 256 episodes on each preset.")
    assert "| [a\\|b](https://example.org) | toy6 |" in text
    assert "| analytic (a paper) (code) | toy6 |" in text
    assert "| local + &lt;b&gt; | train |" in text
    assert "| 1.0 (0.0 to 1.1) |" in text


@pytest.mark.slow
def test_our_folders_can_be_listed():
    entries, folders = all_listed([FOLDER]), list(Path(FOLDER).glob("*/submission.json"))
    assert len(entries) == len(folders) >= 3, "run python -m docs.studies entries"
    assert {entry.submission.scenario for entry in entries} <= set(PRESETS)
    text = tables(entries)
    for submission, report in entries:
        name, share = f"| {submission.name} | {submission.scenario} |", f"| {report.saved_pct[0] + 0.0:.1f} "
        assert any(line.startswith(name) and share in line for line in text.splitlines())
