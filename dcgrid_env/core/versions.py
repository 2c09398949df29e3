"""What stands behind a result: the command, the versions and the machine."""

from __future__ import annotations

import os
import platform
import shlex
import sys
from importlib.metadata import PackageNotFoundError, version
from typing import Any

PACKAGES = ("dcgrid-env", "numpy", "scipy", "numba", "gymnasium", "pettingzoo")


def versions(packages: tuple[str, ...]) -> dict[str, str | None]:
    """Installed version of each package, None where it is not installed."""
    installed: dict[str, str | None] = {}
    for package in packages:
        try:
            installed[package] = version(package)
        except PackageNotFoundError:
            installed[package] = None
    return installed


def meta() -> dict[str, Any]:
    """Command, versions and machine behind a result."""
    return {
        "command": shlex.join(["dcgrid", *sys.argv[1:]]),
        "versions": {"python": platform.python_version(), **versions(PACKAGES)},
        "machine": {"platform": platform.platform(), "processor": platform.machine(), "cores": os.cpu_count()},
    }
