"""What stands behind a result, and writing it whole or not at all."""

from __future__ import annotations

import os
import platform
import shlex
import sys
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from dcgrid_env.files import write_json

__all__ = ["PACKAGES", "meta", "versions", "write_json"]

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
        "command": shlex.join(["dcgrid", *sys.argv[1:]]),
        "versions": {"python": platform.python_version(), **versions(PACKAGES)},
        "machine": {"platform": platform.platform(), "processor": platform.machine(), "cores": os.cpu_count()},
    }
