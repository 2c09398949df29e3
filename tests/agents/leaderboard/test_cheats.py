"""Attempts to cheat that the leaderboard refuses; those of confined code are in test_confinement.py."""

import json
import re
import time
from dataclasses import replace

import pytest
from cryptography.hazmat.primitives.asymmetric import ed25519

from dcgrid_env.agents.leaderboard import remote, verifying
from dcgrid_env.agents.leaderboard.entry_files import SubmissionError, Verified, plain, read
from dcgrid_env.agents.leaderboard.signing import make_keys
from dcgrid_env.agents.leaderboard.submitting import submit
from dcgrid_env.agents.leaderboard.verifying import verify
from dcgrid_env.cli.main import main
from docs.studies.leaderboard import listed
from helpers.submitted_code import acted

PEEKING = """
import sys
import numpy as np

class Peeking:
    "Reads the seeds in the frames of its caller and plays what hindsight plans for them."

    def reset(self, env_info):
        self.scenario, self.t, self.plans = env_info, 0, None

    def act(self, observations):
        if self.plans is None:
            frame = sys._getframe()
            while frame and not isinstance(frame.f_locals.get("seeds"), list | tuple | range):
                frame = frame.f_back
            if frame is None:
                raise LookupError("there are no seeds in the frames")
            from dcgrid_env.baselines.model_based.hindsight import hindsight
            self.plans = [hindsight(self.scenario, seed).actions for seed in frame.f_locals["seeds"]]
        self.t += 1
        return np.array([plan[self.t - 1] for plan in self.plans])
"""


@pytest.fixture(scope="module", autouse=True)
def keys(tmp_path_factory):
    folder = tmp_path_factory.mktemp("keys")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DCGRID_VERIFIER_KEY", str(folder / "verifier.key"))
        patch.setattr("dcgrid_env.agents.leaderboard.signing.PUBLIC", folder / "verifier.pub")
        make_keys()
        yield folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "entry"
    submit("constant-q-tuned", "constant", folder, scenario="toy6", episodes=32)
    verify(folder, fresh=32)
    return folder


@pytest.mark.slow
def test_a_controller_that_reads_its_caller_s_frames_finds_no_seeds(tmp_path):
    (tmp_path / "peek.py").write_text(PEEKING)
    with pytest.raises(ValueError, match="LookupError: there are no seeds in the frames"):
        submit(f"{tmp_path / 'peek.py'}:Peeking", "peek", tmp_path / "out", scenario="toy6", episodes=2, scope="joint")


@pytest.mark.slow
def test_no_field_of_a_submission_chooses_the_fresh_seeds(whole, monkeypatch):
    drawn = [verifying.draw_seed() for _ in range(50)]
    assert len(set(drawn)) == 50
    assert max(drawn) > 2**56  # more than can be tried for the observations of an episode
    first = read(whole / "verified.json", Verified).fresh_seed
    seeds = []
    monkeypatch.setattr(
        verifying, "_report", lambda *given: seeds.append(given[4]) or read(whole / "verified.json", Verified)
    )
    monkeypatch.setattr(verifying, "write_json", lambda *_: None)
    for _ in range(2):
        verify(whole)
    assert len({first, *seeds}) == 3, "the same submission gets other episodes each time"


@pytest.mark.slow
def test_a_report_that_was_written_by_hand_is_not_listed(whole):
    honest = read(whole / "verified.json", Verified)
    forged = replace(honest, score=honest.score._replace(value=0.999))
    mine = ed25519.Ed25519PrivateKey.generate()
    for signature in ("", honest.signature, mine.sign(forged.signed_content).hex()):
        (whole / "verified.json").write_text(json.dumps(plain(replace(forged, signature=signature))))
        with pytest.raises(SubmissionError, match="signature is not the verifier's"):
            listed(whole)
    (whole / "verified.json").write_text(json.dumps(plain(honest)))
    assert listed(whole).verified == honest


def test_a_verifier_without_a_key_writes_no_report_that_is_listed(whole, tmp_path, monkeypatch):
    monkeypatch.setenv("DCGRID_VERIFIER_KEY", str(tmp_path / "none.key"))
    before = (whole / "verified.json").read_text()
    _, report = verify(whole, fresh=32)
    assert report.signature == ""
    with pytest.raises(SubmissionError, match="signature is not the verifier's"):
        listed(whole)
    (whole / "verified.json").write_text(before)


@pytest.mark.parametrize(
    ("scope", "columns"),
    [
        ("local", [[0, 1, 2, 3, 4, 7, 8], [9, 10, 11, 12, 13], [16, 17, 18, 19, 20]]),
        ("local + sensitivities", [list(range(9)), list(range(9, 16)), list(range(16, 23))]),
        ("joint + sensitivities", [list(range(23))] * 3),
    ],
)
@pytest.mark.slow
def test_an_agent_sees_what_the_scope_sends_alone(scope, columns):
    body = """seen = np.flatnonzero(observations[0] == np.arange(23))
return np.full((len(observations), 4), (2.0**seen).sum())"""
    site, *inverters = [sum(2.0**i for i in of_agent) for of_agent in columns]
    assert acted(body, scope).tolist() == [[site, site, *inverters]] * 2  # clock and q of the site, q of the inverters


@pytest.mark.slow
def test_agents_under_a_local_scope_share_no_memory():
    body = "seen.append(1)\nreturn np.full((len(observations), 4), len(seen))"
    assert (acted(body, "local") == 1.0).all()


@pytest.mark.slow
def test_code_sees_nothing_of_the_verifier_s_environment():
    with pytest.raises(remote.ProcessError, match="KeyError: 'DCGRID_VERIFIER_KEY'"):
        acted("__import__('os').environ['DCGRID_VERIFIER_KEY']")


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("import os; os._exit(3)", r"its process ended \(exit status 3\)"),
        ("import os; os.kill(os.getpid(), 9)", r"its process ended \(signal 9\)"),
        ("import time; time.sleep(60)", "gave no answer within 1 s"),
        ("import os, sys; os.write(int(sys.argv[1]), b'x'); import time; time.sleep(60)", "gave no answer within 1 s"),
        ("import os, sys; os.write(int(sys.argv[1]), b'=' + (2**40).to_bytes(8, 'little'))", "it sent 1099511627776 b"),
        (
            "import os, sys; os.write(int(sys.argv[1]), b'=' + bytes(8)); import time; time.sleep(60)",
            "sent 0 bytes, expected 64",
        ),
        ("import os, sys; os.write(int(sys.argv[1]), b'!' + bytes([3]) + bytes(7) + b'[[[')", "cannot be read"),
        ("return np.zeros(3)", r"the action has shape \(3,\); give \(2, 4\)"),
        ("raise SystemExit('\\x1b[2J\\n' + 'x' * 9000)", r"^SystemExit:  \[2J x{100,}"),
        ("raise KeyError", "KeyError"),
    ],
)
@pytest.mark.slow
def test_code_that_hangs_dies_or_answers_with_anything_is_one_error(body, said, monkeypatch):
    monkeypatch.setattr(remote, "STEP_S", 1.0)
    began = time.monotonic()
    with pytest.raises(remote.ProcessError, match=said) as raised:
        acted(body)
    assert len(str(raised.value)) < 400
    assert str(raised.value).isprintable()
    assert time.monotonic() - began < 55.0


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("def", "importing controller.py fails.*SyntaxError"),
        ("", "has no 'Own'"),
        ("class Own: ...", "Own is no controller"),
        ("import sys; sys.exit(1)", "importing controller.py fails.*SystemExit"),
        ("import os; os._exit(1)", r"its process ended \(exit status 1\)"),
    ],
)
@pytest.mark.slow
def test_code_that_cannot_be_loaded_is_one_line(code, said, tmp_path, capsys):
    (tmp_path / "own.py").write_text(code)
    with pytest.raises(SystemExit):
        main(
            [
                "submit", f"{tmp_path / 'own.py'}:Own", "--name", "x", "--scenario", "toy6", "--scope", "joint",
                "--episodes", "2", "--out", str(tmp_path / "out"),
            ]
        )  # fmt: skip
    line = capsys.readouterr().err
    assert re.fullmatch(f"dcgrid: controller 'controller.py:Own' fails in loading: .*{said}.*\n", line), line
    assert not (tmp_path / "out").exists()
