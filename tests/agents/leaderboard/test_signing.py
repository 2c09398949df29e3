"""Keys of the verifier."""

import shutil
import subprocess
import sys

import pytest

from dcgrid_env.agents.leaderboard import signing
from dcgrid_env.agents.leaderboard.entry_files import SubmissionError
from dcgrid_env.agents.leaderboard.signing import is_signed, make_keys, private_key, sign
from helpers.places import ROOT


@pytest.fixture
def keys(tmp_path, monkeypatch):
    monkeypatch.setattr(signing, "PUBLIC", tmp_path / "verifier.pub")
    monkeypatch.setenv("DCGRID_VERIFIER_KEY", str(tmp_path / "keys" / "verifier.key"))
    return make_keys()


def test_a_private_key_is_never_replaced(keys):
    before = keys.read_text(), signing.PUBLIC.read_text()
    with pytest.raises(SubmissionError, match="there is a key; move it away"):
        make_keys()
    assert (keys.read_text(), signing.PUBLIC.read_text()) == before
    assert keys.stat().st_mode & 0o777 == 0o600
    assert is_signed(b"x", sign(b"x"))


def test_a_private_key_that_does_not_fit_signs_nothing(keys, tmp_path):
    public = signing.PUBLIC.read_text()
    shutil.move(keys, tmp_path / "first.key")
    assert private_key() is None
    assert sign(b"x") == ""
    make_keys()
    signing.PUBLIC.write_text(public)
    for call in (private_key, lambda: sign(b"x")):
        with pytest.raises(SubmissionError, match=r"verifier\.key: does not fit the public key in .*verifier\.pub"):
            call()


@pytest.mark.parametrize("content", [None, "00" * 32])
def test_our_entries_need_the_key_of_the_public_key(content, tmp_path, monkeypatch):
    """Without it the script ends with one line before it makes an entry, and leaves verifier.pub unchanged."""
    key, public = tmp_path / "verifier.key", ROOT / "agents" / "leaderboard" / "verifier.pub"
    if content is not None:
        key.write_text(content)
    monkeypatch.setenv("DCGRID_VERIFIER_KEY", str(key))
    before = public.read_text()
    try:
        ended = subprocess.run(
            [sys.executable, ROOT / "docs" / "leaderboard.py", "no-preset"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
        )
        assert public.read_text() == before
    finally:
        public.write_text(before)
    assert ended.returncode == 1
    assert len(ended.stderr.splitlines()) == 1
    assert str(key) in ended.stderr
    assert "--new-key" in ended.stderr
    assert key.exists() == (content is not None)
