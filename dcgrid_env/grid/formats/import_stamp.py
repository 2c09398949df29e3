"""The stamp of a feeder's folder whose import was not verified: the table ``import`` of its feeder.toml.

``verdict`` states what is wrong, ``accepted`` whether the user accepted it when importing. Reading such a folder warns;
commands refuse it unless it is accepted.
"""

from __future__ import annotations

import json
import tomllib
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dcgrid_env.grid.formats.feeder_tables import file_text
from dcgrid_env.grid.topology import FeederError

STAMP = "import"
"""Key of the table in feeder.toml."""
UNVERIFIED = "unverified"
"""Word that accepts such a folder on the command line."""
_FILE = "feeder.toml"


class UnverifiedFeederWarning(UserWarning):
    """A feeder was read whose import was not verified by the power flow of the source's program."""


class AcceptedFeederWarning(UnverifiedFeederWarning):
    """A feeder was read whose import was not verified and was accepted by ``--allow unverified``."""


def write_stamp(folder: Path, verdict: str, accepted: bool) -> None:
    """Add the stamp to the folder of a feeder that was just written."""
    path = folder / _FILE
    text = f"\n[{STAMP}]\nverdict = {json.dumps(verdict)}\naccepted = {str(accepted).lower()}\n"
    path.write_text(path.read_text(encoding="utf-8") + text, encoding="utf-8", newline="\n")


def without_stamp(path: Path, head: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of feeder.toml other than the stamp; FeederError for a stamp that no import writes."""
    stamp = head.get(STAMP, {"verdict": "", "accepted": False})
    if not (
        isinstance(stamp, dict)
        and set(stamp) == {"verdict", "accepted"}
        and isinstance(stamp["verdict"], str)
        and isinstance(stamp["accepted"], bool)
    ):
        raise FeederError(f"{path}: [{STAMP}] is {stamp!r}; it has verdict, a text, and accepted, true or false")
    return {key: value for key, value in head.items() if key != STAMP}


def warn_about_stamp(folder: Path) -> None:
    """Warn if a folder that was read has a stamp."""
    stamp = tomllib.loads(file_text(folder / _FILE)).get(STAMP)
    if stamp:
        category = AcceptedFeederWarning if stamp["accepted"] else UnverifiedFeederWarning
        warnings.warn(f"feeder {folder}: the import is not verified: {stamp['verdict']}", category, stacklevel=3)
