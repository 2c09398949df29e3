"""Keys of the verifier."""

import shutil

import pytest

from dcgrid_env.agents.leaderboard import signing
from dcgrid_env.agents.leaderboard.entry_files import SubmissionError
from dcgrid_env.agents.leaderboard.signing import is_signed, make_keys, private_key, sign
from docs.studies.commands import main
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
    public, signed = signing.PUBLIC.read_text(), sign(b"x")
    shutil.move(keys, tmp_path / "first.key")
    assert private_key() is None
    assert sign(b"x") == ""
    make_keys()
    assert is_signed(b"x", signed)  # by the key before
    again = sign(b"x")
    assert is_signed(b"x", again)
    signing.PUBLIC.write_text(public)
    assert not is_signed(b"x", again)
    for call in (private_key, lambda: sign(b"x")):
        with pytest.raises(SubmissionError, match=r"verifier\.key: does not fit a public key in .*verifier\.pub"):
            call()


@pytest.mark.parametrize("content", [None, "00" * 32])
def test_our_entries_need_the_key_of_the_public_key(content, tmp_path, monkeypatch, capsys):
    """Without it the command ends with one line before it makes an entry, and leaves verifier.pub unchanged."""
    key, public = tmp_path / "verifier.key", ROOT / "agents" / "leaderboard" / "verifier.pub"
    if content is not None:
        key.write_text(content)
    monkeypatch.setenv("DCGRID_VERIFIER_KEY", str(key))
    monkeypatch.chdir(tmp_path)
    before = public.read_text()
    with pytest.raises(SystemExit, match="2"):
        main(["entries", "--scenarios", "toy6"])
    assert public.read_text() == before
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert str(key) in said
    assert "--new-key" in said
    assert [path.name for path in tmp_path.iterdir()] == [key.name] * (content is not None)
