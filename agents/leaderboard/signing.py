"""Signatures of verification reports: Ed25519, which everybody can check and only the verifier can make.

The public keys are in ``verifier.pub`` next to this file, one a line, so that reports stay valid when a new key
replaces a lost one. The private key is a file outside of the repository.
"""

from __future__ import annotations

import os
from importlib.resources import files
from pathlib import Path
from types import ModuleType
from typing import Any

from dcgrid_env.agents.leaderboard.entry_files import SubmissionError
from dcgrid_env.core.files import write_text
from dcgrid_env.core.install import from_clone

PUBLIC = Path(str(files("dcgrid_env.agents.leaderboard") / "verifier.pub"))
"""File of the verifier's public keys, each a line of hexadecimal digits."""
KEY_VARIABLE = "DCGRID_VERIFIER_KEY"
"""Environment variable with the path of the private key."""
NEW_KEY = "python -m docs.studies entries --new-key"
"""Command that makes a new pair of keys."""


def private_key_file() -> Path:
    """Path of the private key, whether it is there or not."""
    return Path(os.environ.get(KEY_VARIABLE) or Path.home() / ".config" / "dcgrid" / "verifier.key")


def make_keys() -> Path:
    """Make a new private key, and add its public key to ``PUBLIC``; the file of the private key.

    Reports that were signed with the keys before stay listed. If someone else may have a key, delete its line.

    Raises
    ------
    SubmissionError
        If there is a file of a private key, which is kept.
    """
    private, path = _ed25519().Ed25519PrivateKey.generate(), private_key_file()
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    try:
        opened = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        raise SubmissionError(f"{path}: there is a key; move it away, or set {KEY_VARIABLE} to another file") from None
    with os.fdopen(opened, "w") as file:
        file.write(private.private_bytes_raw().hex() + "\n")
    before = PUBLIC.read_text(encoding="ascii") if PUBLIC.exists() else ""
    write_text(PUBLIC, before + private.public_key().public_bytes_raw().hex() + "\n")
    return path


def private_key() -> Any:
    """The verifier's private key; None where its file is missing.

    Raises
    ------
    SubmissionError
        If its public key is not in ``PUBLIC``.
    """
    path = private_key_file()
    if not path.is_file():
        return None
    private = _ed25519().Ed25519PrivateKey.from_private_bytes(_keys(path)[0])
    if private.public_key().public_bytes_raw() not in _keys(PUBLIC):
        raise SubmissionError(
            f"{path}: does not fit a public key in {PUBLIC}; set {KEY_VARIABLE} to the verifier's key, or make a "
            f"new one with {NEW_KEY}"
        )
    return private


def sign(content: bytes) -> str:
    """Signature in hexadecimal digits; empty without a private key."""
    private = private_key()
    return "" if private is None else private.sign(content).hex()


def is_signed(content: bytes, signature: str) -> bool:
    """Whether the verifier signed this content."""
    from cryptography.exceptions import InvalidSignature

    for key in _keys(PUBLIC):
        try:
            _ed25519().Ed25519PublicKey.from_public_bytes(key).verify(bytes.fromhex(signature), content)
        except (InvalidSignature, ValueError):
            continue
        return True
    return False


def _keys(path: Path) -> list[bytes]:
    """The keys in a file; SubmissionError, naming the file, if it contains none or something else."""
    try:
        keys = [bytes.fromhex(line) for line in path.read_text(encoding="ascii").splitlines()]
    except (OSError, ValueError) as error:
        raise SubmissionError(f"{path}: is not a key ({error}); make one with {NEW_KEY}") from None
    if not keys or any(len(key) != 32 for key in keys):
        sizes = ", ".join(str(len(key)) for key in keys) or "no"
        raise SubmissionError(f"{path}: has {sizes} bytes, a key has 32; make one with {NEW_KEY}")
    return keys


def _ed25519() -> ModuleType:
    try:
        from cryptography.hazmat.primitives.asymmetric import ed25519
    except ImportError:
        raise SubmissionError(
            f"signatures need the package cryptography; install it, {from_clone('leaderboard')}"
        ) from None
    return ed25519
