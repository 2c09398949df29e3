"""Files that are written whole or not at all, so that an interruption leaves no half of one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 beside ``path`` first and put it in place when it is whole; folders are made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """The same for JSON; a NaN in it is a ValueError, before anything is written."""
    write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")
