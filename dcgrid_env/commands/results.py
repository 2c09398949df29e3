"""What stands behind a result, and writing it whole or not at all."""

from __future__ import annotations

import json
import os
import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGES = ("dcgrid-env", "numpy", "scipy", "numba", "gymnasium", "pettingzoo")


def versions(packages: tuple[str, ...]) -> dict[str, str | None]:
    """Installed version of each package, None where it is not installed."""
    found: dict[str, str | None] = {}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = None
    return found


def meta() -> dict[str, Any]:
    """Command, versions and machine behind a result."""
    return {
        "command": " ".join(["dcgrid", *sys.argv[1:]]),
        "versions": {"python": platform.python_version(), **versions(PACKAGES)},
        "machine": {"platform": platform.platform(), "processor": platform.machine(), "cores": os.cpu_count()},
    }


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write JSON beside ``path`` first and put it in place when it is whole; a NaN in it is a ValueError."""
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)
