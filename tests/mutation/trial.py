"""Runs tests in copies of a tree, each in a separate process, so a trial leaves no traces."""

from __future__ import annotations

import contextlib
import importlib
import multiprocessing
import os
import resource
import shutil
import signal
import sys
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

LEFT_OUT = (".*", "__pycache__", "*.egg-info", "build", "dist", "results", "shared")
OLD_S = 946_684_800
"""Time of change of every file of a copy, so that a compiled file is never taken for that of a mutant made later."""
MEMORY_BYTES = 24 * 2**30
TEST_CPU_S = 120.0
"""Limit of one test in CPU time, so that an endless loop does not run for the time limit of all tests."""

_fork: Any = multiprocessing.get_context("fork")


def preload(modules: list[str]) -> None:
    """Import modules that the processes of the trials inherit; missing ones are skipped."""
    for name in ("pytest", *modules):
        try:
            importlib.import_module(name)
        except ImportError:
            continue


def copy_tree(root: Path, to: Path) -> None:
    """A copy of the tree that imports by itself: the folders mapped in pyproject.toml are linked into the package."""
    shutil.copytree(root, to, symlinks=True, ignore=shutil.ignore_patterns(*LEFT_OUT))
    project = to / "pyproject.toml"
    tool = tomllib.loads(project.read_text()).get("tool", {}) if project.is_file() else {}
    for package, folder in tool.get("setuptools", {}).get("package-dir", {}).items():
        link = to / package.replace(".", "/")
        if not link.exists():
            # Relative, so that a copy of this copy holds together by itself.
            link.symlink_to(os.path.relpath(to / folder, link.parent), target_is_directory=True)
    for path in to.rglob("*.py"):
        os.utime(path, (OLD_S, OLD_S))


@dataclass
class Trial:
    """Tests under way in a copy."""

    copy: Path
    process: Any
    began_s: float
    limit_s: float
    output: Path

    @property
    def spent_s(self) -> float:
        return time.monotonic() - self.began_s

    def kill(self) -> None:
        """End the trial and all that it has started."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.join()

    def failure(self) -> str:
        """The test that failed, or the last line that pytest wrote."""
        lines = self.output.read_text(errors="replace").strip().splitlines() or [""]
        return next((line for line in lines if line.startswith(("FAILED ", "ERROR "))), lines[-1])

    def ended(self) -> str | None:
        """ "passed", "failed", "timed out", or None while it is under way."""
        if self.process.is_alive():
            if self.spent_s <= self.limit_s:
                return None
            self.kill()
            return "timed out"
        self.process.join()
        return {0: "passed", -signal.SIGVTALRM: "timed out"}.get(self.process.exitcode, "failed")


def begin(copy: Path, tests: list[str], limit_s: float, cache: Path | None, *, first: bool = False) -> Trial:
    """Run tests in a copy until one fails.

    Kernels are cached in ``cache``, or in the user's cache folder if it is None; ``first`` keeps compiled Python too,
    which is right for sources that do not change.
    """
    output = copy.with_name(copy.name + ".txt")
    process = _fork.Process(target=_child, args=(copy, tests, cache, output, first))
    began_s = time.monotonic()
    process.start()
    return Trial(copy, process, began_s, limit_s, output)


def _child(copy: Path, tests: list[str], cache: Path | None, output: Path, first: bool) -> None:
    os.setsid()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    with output.open("wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    os.chdir(copy)
    os.environ |= {"PYTHONPATH": str(copy)} | ({} if first else {"PYTHONDONTWRITEBYTECODE": "1"})
    os.environ.pop("NUMBA_CACHE_DIR", None)
    if cache is not None:
        os.environ["NUMBA_CACHE_DIR"] = str(cache)
    if numba := sys.modules.get("numba"):
        numba.config.reload_config()
    sys.path.insert(0, str(copy))
    sys.dont_write_bytecode = not first
    import pytest

    class Limit:
        """Kill the process in a test that computes for too long."""

        def pytest_runtest_logstart(self) -> None:
            signal.setitimer(signal.ITIMER_VIRTUAL, 0.0 if first else TEST_CPU_S)

    options = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider", "--rootdir", str(copy), "--no-header", "--tb=line"]
    code = int(pytest.main([*options, *tests], plugins=[Limit()]))
    sys.stdout.flush()
    os._exit(code)
