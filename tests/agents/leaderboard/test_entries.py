"""Entries of the leaderboard: submission, verification and listing; changed entries are detected."""

import json
import random
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dcgrid_env import PRESETS
from dcgrid_env.agents import Network, Policy
from dcgrid_env.agents.leaderboard.confinement import version
from dcgrid_env.agents.leaderboard.entry_files import Submission, SubmissionError, Verified, read
from dcgrid_env.agents.leaderboard.running import scenario_of
from dcgrid_env.agents.leaderboard.signing import PUBLIC, make_keys
from dcgrid_env.agents.leaderboard.submitting import submit
from dcgrid_env.agents.leaderboard.verifying import verify, verify_again
from dcgrid_env.agents.policy.policy import FOLDER
from dcgrid_env.baselines import published
from dcgrid_env.cli.main import main
from dcgrid_env.core.files import sha256_of
from docs.studies.commands import main as studies
from docs.studies.leaderboard import FOLDER as ENTRIES
from docs.studies.leaderboard import Listed, all_listed, listed, tables
from helpers.fuzzing import mutated_bytes

PRESET, POLICY = "toy6", FOLDER / "toy6-analytic.safetensors"
OWN = """
class Own:
    def __init__(self, q=0.0):
        self.q = q

    def reset(self, env_info):
        self.n = 4

    def act(self, observations):
        return [[1.0, self.q, self.q, self.q]] * len(observations)
"""


@pytest.fixture(scope="module", autouse=True)
def _keys(tmp_path_factory):
    """A verifier's keys for these tests."""
    folder = tmp_path_factory.mktemp("keys")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DCGRID_VERIFIER_KEY", str(folder / "verifier.key"))
        patch.setattr("dcgrid_env.agents.leaderboard.signing.PUBLIC", folder / "verifier.pub")
        make_keys()
        yield


@pytest.fixture(scope="module")
def entry(tmp_path_factory):
    """A verified folder of few episodes."""
    folder = tmp_path_factory.mktemp("entries") / "entry"
    submit(str(POLICY), "analytic", folder, paper="https://example.org", episodes=4)
    verify(folder, fresh=4)
    return folder


@pytest.fixture
def copied(entry, tmp_path):
    return Path(shutil.copytree(entry, tmp_path / "copied"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A verified folder that can be listed, of a policy that ships."""
    folder = tmp_path_factory.mktemp("whole") / "entry"
    submit("toy6-analytic", "analytic", folder, episodes=32)
    verify(folder, fresh=32)
    return folder


def changed(path, **fields):
    """A record with other values for some fields, ``part__field`` for those of a part."""
    content = json.loads(path.read_text())
    for name, value in fields.items():
        part, _, field = name.partition("__")
        if field:
            content[part][field] = value
        else:
            content[name] = value
    path.write_text(json.dumps(content))


def constant():
    """A policy of other weights than those that ship: it sets what it sets whatever it sees."""
    networks = {
        name: Network([(np.zeros((n, m)), np.full(m, 0.5))])
        for name, n, m in (("datacenter", 9, 2), ("inverter", 7, 1))
    }
    return Policy(networks, scenario=PRESET)


def stopped(capsys, *arguments, run=main):
    with pytest.raises(SystemExit) as raised:
        run([str(argument) for argument in arguments])
    said = capsys.readouterr().err
    assert (raised.value.code, len(said.splitlines())) == (2, 1)
    return said


def test_an_entry_is_found_as_claimed(entry):
    claimed, found = read(entry / "submission.json", Submission), read(entry / "verified.json", Verified)
    assert pytest.approx(claimed.claimed.J, rel=1e-6) == found.found.J
    assert (claimed.kind, claimed.scope, claimed.learned_on) == ("file", "local + sensitivities", "train")
    assert set(claimed.files) == {"policy.safetensors", "policy.json"} == {p.name for p in entry.iterdir()} - {
        "submission.json", "verified.json",
    }  # fmt: skip
    assert found.fresh.J != found.found.J
    assert claimed.claimed.gain[0] == pytest.approx(1 - claimed.claimed.J / claimed.claimed.J_droop, rel=1e-9)


def test_the_episodes_of_a_report_give_the_same_again_to_the_last_bit(copied, capsys):
    before = (copied / "verified.json").read_bytes()
    _, report, is_equal = verify_again(copied)
    assert is_equal
    assert report.fresh_seed >= 1000
    main(["verify", str(copied), "--again"])
    assert "agrees with the signed report bit for bit" in capsys.readouterr().out
    assert (copied / "verified.json").read_bytes() == before
    with pytest.raises(SubmissionError, match="fresh is 1; give at least 2"):
        verify(copied, fresh=1)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"claimed__J": 0.2}, "claimed.J is 0.2, found 0."),
        ({"score__value": 0.99}, "score.value is 0.99, found "),
        ({"claimed__J": float("nan")}, "claimed.J: input should be a finite number"),
        ({"score__value": float("nan")}, "score.value: input should be a finite number"),
        ({"name": "a\n| b"}, "name is 'a\\n| b'; give one line"),
        ({"claimed__delay_mean_s": 1.0}, "claimed.delay_mean_s is 1, found 0"),
        ({"claimed__gain": [0.5, 0.4, 0.6]}, "claimed.gain is 0.5, found "),
        ({"scenario_hash": "0" * 16}, "scenario_hash is 0000000000000000, that of toy6 is "),
        ({"scenario": "mine"}, "scenario is 'mine'; the leaderboard is over the presets"),
        ({"scenario": "ieee33"}, "that of ieee33 is "),
        ({"episodes": 5}, "that of the test seeds 0 to 4 is "),
        ({"episodes": 101}, "episodes is 101; toy6 has 100 published ones"),
        ({"sha256": "0" * 64}, "sha256 is 0000000000000000.., that of the policy policy.safetensors is "),
        ({"scope": "local"}, "scope is 'local', found 'local + sensitivities'"),
        ({"files": {}}, "policy is 'policy.safetensors', which is none of kind file"),
        ({"kind": "named"}, "policy is 'policy.safetensors', which is none of kind named"),
        ({"files": {"../policy.json": "0"}}, "files: '../policy.json' is outside the folder"),
        ({"format": 7}, "format is 7, this dcgrid reads 2"),
        ({"learned_on": "luck"}, "learned_on: "),
        ({"more": 1}, "more: "),
    ],
)
def test_a_changed_submission_is_one_line_and_leaves_what_was_verified(fields, said, copied, capsys):
    before = (copied / "verified.json").read_bytes()
    changed(copied / "submission.json", **fields)
    error = stopped(capsys, "verify", copied, "--fresh", 2)
    assert said in error
    assert "submission.json" in error or "published" in error or "presets" in error
    assert (copied / "verified.json").read_bytes() == before


def test_changed_and_missing_files_are_named(copied, capsys):
    weights = copied / "policy.safetensors"
    content = bytearray(weights.read_bytes())
    content[-1] ^= 1
    weights.write_bytes(content)
    assert "policy.safetensors: sha256 is " in stopped(capsys, "verify", copied)
    weights.unlink()
    assert "policy.safetensors: is missing" in stopped(capsys, "verify", copied)
    (copied / "submission.json").write_text("{")
    assert "submission.json: it: " in stopped(capsys, "verify", copied)
    (copied / "submission.json").unlink()
    assert "give a folder that dcgrid submit wrote" in stopped(capsys, "verify", copied)


@pytest.mark.slow
def test_other_weights_under_hashes_made_anew_are_noticed(copied, capsys):
    other = constant()
    other.save(copied / "policy.safetensors")
    files = {name: sha256_of(copied / name) for name in ("policy.safetensors", "policy.json")}
    changed(copied / "submission.json", files=files)
    assert "that of the policy policy.safetensors is " in stopped(capsys, "verify", copied)
    changed(copied / "submission.json", sha256=other.sha256)
    assert "claimed.J is 0." in stopped(capsys, "verify", copied)


def test_a_card_that_says_something_else_is_noticed(copied, capsys, tmp_path):
    card, weights = copied / "policy.json", copied / "policy.safetensors"
    about = json.loads(card.read_text())["scored"] | {"episodes": 4, "score": [0.99, 0.98, 1.0]}
    changed(card, scored=about, seed=None)  # of no seed, whose figures would differ
    changed(copied / "submission.json", files={file.name: sha256_of(file) for file in (card, weights)})
    assert "policy.json: scored.score is 0.99, claimed is 0." in stopped(capsys, "verify", copied)
    line = stopped(capsys, "submit", copied, "--name", "x", "--episodes", 4, "--out", tmp_path / "out")
    assert "give a card that says what the policy reaches" in line
    changed(card, scored=None, sha256="0" * 64)
    line = stopped(capsys, "submit", weights, "--name", "x", "--episodes", 4, "--out", tmp_path / "out")
    assert "policy.json: sha256 is '0000" in line
    card.write_text("[" * 100_000)
    assert "nested more than 64 deep; give a card that Policy.save wrote" in stopped(
        capsys, "submit", weights, "--name", "x", "--out", tmp_path / "out"
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(not version(), reason="this system cannot confine code")
@pytest.mark.slow
def test_code_of_ones_own_runs_when_trusted_alone(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(OWN)
    base = ("submit", "own.py:Own(q=0.1)", "--name", "own", "--scenario", PRESET, "--episodes", "2", "--out", "made")
    assert "scope is ''; say what the code is to be sent" in stopped(capsys, *base)
    assert "scope is 'all'; give local or joint" in stopped(capsys, *base, "--scope", "all")
    assert not Path("made").exists()
    main([*base, "--scope", "joint"])
    assert {path.name for path in Path("made").iterdir()} == {"controller.py", "submission.json"}
    assert "verifying runs it: read it, and add --trust" in stopped(capsys, "verify", "made")
    main(["verify", "made", "--trust", "--fresh", "2"])
    assert "the claim is confirmed, information: joint" in capsys.readouterr().out
    assert read(Path("made/submission.json"), Submission).policy == "controller.py:Own(q=0.1)"
    text = Path("made/submission.json").read_text()
    changed(Path("made/submission.json"), policy="controller.py")
    assert "policy is 'controller.py', which is none of kind code" in stopped(capsys, "verify", "made", "--trust")
    Path("made/submission.json").write_text(text)
    with monkeypatch.context() as patch:
        patch.setattr("dcgrid_env.agents.leaderboard.verifying.version", lambda: 0)
        assert "code, which this system cannot confine" in stopped(capsys, "verify", "made", "--trust")
    with monkeypatch.context() as patch:
        patch.syspath_prepend(tmp_path / "keys")
        patch.setenv("DCGRID_VERIFIER_KEY", str(tmp_path / "keys" / "below" / "verifier.key"))
        (tmp_path / "keys").mkdir()
        assert "which code of a submitter can read; move it" in stopped(capsys, "verify", "made", "--trust")
    with Path("made/controller.py").open("a") as file:
        file.write("print('more')\n")
    assert "controller.py: sha256 is " in stopped(capsys, "verify", "made", "--trust")
    assert "which is there and not empty" in stopped(capsys, *base, "--scope", "joint")


@pytest.mark.parametrize(
    ("kind", "policy"),
    [
        ("named", "MARK.py:Own"),
        ("file", "controller.py:Own"),
        ("named", "guarded:MARK.py:Own"),
        ("named", ".safetensors"),
    ],
)
def test_no_code_runs_under_another_kind_s_name(kind, policy, copied, capsys, tmp_path):
    code = f"import pathlib\npathlib.Path({str(tmp_path / 'ran')!r}).touch()\n{OWN}"
    for path in (tmp_path / "mark.py", copied / "controller.py"):
        path.write_text(code)
    files = {"controller.py": sha256_of(copied / "controller.py")}
    policy = policy.replace("MARK.py", str(tmp_path / "mark.py"))
    changed(copied / "submission.json", kind=kind, policy=policy, files=files)
    assert f"which is none of kind {kind}" in stopped(capsys, "verify", copied)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("droop-tuned", "--name", "x"), "was not trained on a preset; pass --scenario"),
        (("json:loads", "--name", "x", "--scenario", PRESET), "give path/to/file.py:Class, whose file goes"),
        (("none.safetensors", "--name", "x", "--scenario", PRESET), "there is no file none.safetensors"),
        (("model.zip", "--name", "x", "--scenario", PRESET), "not a zip that Stable-Baselines3 wrote"),
        (("toy6-analytic", "--name", "a\nb"), "name is 'a\\nb'; give one line"),
        (("toy6-analytic", "--name", "x", "--episodes", "1"), "episodes is 1; toy6 has 100 published ones"),
        (("toy6-analytic", "--name", "x", "--scope", "local"), "scope is 'local'; leave it out"),
        (("toy6-analytic", "--name", "x", "--scenario", "mine.toml"), "scenario is 'mine.toml'; the leaderboard is"),
    ],
)
def test_what_cannot_be_entered_is_one_line(arguments, said, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("model.zip").touch()
    assert said in stopped(capsys, "submit", *arguments)
    assert not Path("results").exists()


def test_a_policy_under_guard_is_entered_too(tmp_path):
    entry = submit(f"guarded:{POLICY}", "guarded", tmp_path / "entry", episodes=2)
    assert (entry.kind, entry.policy, entry.scope) == ("file", "guarded:policy.safetensors", "local + sensitivities")
    _, found = verify(tmp_path / "entry", fresh=2)
    assert pytest.approx(entry.claimed.J, rel=1e-6) == found.found.J


@pytest.mark.slow
def test_verified_folders_are_checked_and_listed(whole, tmp_path, capsys):
    for folder in (whole, whole.parent):  # a folder, and a folder of folders
        studies(["leaderboard", str(folder)])
        assert capsys.readouterr().out == "1 entries can be listed\n"
        assert all_listed([folder]) == [listed(whole)]
    twice = shutil.copytree(whole, tmp_path / "twice")
    assert "also has the name 'analytic' on toy6" in stopped(capsys, "leaderboard", whole, twice, run=studies)


@pytest.mark.parametrize(
    ("file", "fields", "said"),
    [
        ("verified.json", {"score__value": 0.99}, "signature is not the verifier's"),
        ("verified.json", {"fresh_seed": 1000}, "signature is not the verifier's"),
        ("verified.json", {"signature": ""}, "signature is not the verifier's"),
        ("verified.json", {"signature": "no digits"}, "signature is not the verifier's"),
        ("submission.json", {"name": "other"}, "submission is of another submission.json"),
        ("submission.json", {"learned_on": "nothing"}, "submission is of another submission.json"),
    ],
)
def test_what_was_changed_after_it_was_verified_is_not_listed(file, fields, said, whole, tmp_path):
    folder = shutil.copytree(whole, tmp_path / "entry")
    changed(folder / file, **fields)
    with pytest.raises(SubmissionError, match=said):
        listed(folder)


@pytest.mark.parametrize("file", ["submission.json", "verified.json", "card and weights"])
@pytest.mark.slow
def test_a_damaged_folder_is_refused_by_its_file_or_reads_as_the_same(file, entry, tmp_path, monkeypatch):
    monkeypatch.setattr("docs.studies.leaderboard.PUBLISHED_EPISODES", 4)
    folder, same, refused = Path(shutil.copytree(entry, tmp_path / "entry")), listed(entry), 0
    names = [file] if file.endswith(".json") else sorted(json.loads((entry / "submission.json").read_text())["files"])
    whole_files, rng = {name: (folder / name).read_bytes() for name in names}, random.Random(3)
    assert whole_files
    for _ in range(300):
        for name, content in mutated_bytes(whole_files, rng).items():
            (folder / name).write_bytes(content)
        said = None
        try:
            assert listed(folder) == same
        except SubmissionError as error:
            said = str(error)
        if said is not None:
            refused += 1
            assert said.startswith(str(folder))
            assert said.isprintable()  # one line
    assert refused > 200


def test_a_report_against_another_reference_or_other_hindsight_is_not_listed(whole, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("docs.studies.leaderboard.reference", lambda _: "Droop(k_p_mw_per_pu=9.0)")
        with pytest.raises(
            SubmissionError, match=r"reference is Droop\(.*, now Droop\(k_p_mw_per_pu=9.0\); submit and"
        ):
            listed(whole)
    best = published(scenario_of(PRESET))
    assert best is not None
    monkeypatch.setattr("dcgrid_env.agents.leaderboard.running.published", lambda _: best._replace(J=best.J - 1e-3))
    with pytest.raises(SubmissionError, match=r"episodes_hash is .*; submit and verify again"):
        listed(whole)


def test_what_was_not_verified_or_has_few_episodes_is_not_listed(copied, monkeypatch, whole):
    with pytest.raises(SubmissionError, match="episodes is 4; the page takes at least 32"):
        listed(copied)
    (copied / "verified.json").unlink()
    with pytest.raises(SubmissionError, match="run dcgrid verify on the folder"):
        listed(copied)
    other = constant()
    monkeypatch.setattr(Policy, "load", lambda name: other)
    with pytest.raises(SubmissionError, match="policy is of other weights than toy6-analytic that ships"):
        listed(whole)


def test_groups_and_texts_of_the_tables(whole):
    entry = listed(whole)

    def of(**fields):
        return Listed(replace(entry.submission, **fields), entry.verified)

    aided, own = replace(entry.verified, scope="local + model"), replace(entry.verified, scope="local")
    worse = entry.verified.found._replace(gain=(0.01, 0.0, 0.011))
    text = tables(
        [
            of(name="a|b", paper="https://example.org/x"),
            Listed(entry.submission, aided),
            Listed(replace(entry.submission, kind="code"), own),
            of(learned_on="test"),
            Listed(entry.submission, replace(entry.verified, fresh=worse)),
        ]
    ).replace("\u00a0", " ")
    main_table, title, of_test = text.partition("### Learned or tuned on the test split\n")
    assert (main_table.count("| toy6 |"), of_test.count("| toy6 |"), bool(title)) == (4, 1, True)
    assert "| [a\\|b](https://example.org/x) | toy6 |" in text
    assert "| analytic (code) | toy6 |" in text
    assert "| local + model | train |" in text
    assert "1.0 (0.0 to 1.1) below |" in text


@pytest.mark.slow
def test_our_folders_can_be_listed(monkeypatch):
    monkeypatch.setattr("dcgrid_env.agents.leaderboard.signing.PUBLIC", PUBLIC)
    folders = sorted(path.parent for path in ENTRIES.glob("*/submission.json"))
    entries = all_listed([ENTRIES])
    assert len(entries) == len(folders) >= 3, "run python -m docs.studies entries"
    assert {entry.submission.scenario for entry in entries} <= set(PRESETS)
    text = tables(entries)
    for submission, record in entries:
        score = f"{record.score.value + 0.0:.2f} "
        name = f"| {submission.name} | {submission.scenario} |"
        assert [line for line in text.splitlines() if line.startswith(name) and f"| {score}" in line]
