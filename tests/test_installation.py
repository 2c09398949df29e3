"""Installed from a copy of the tree into separate environments: one way after the other, and read-only."""

import os
import shutil
import site
import subprocess
import sys
import tempfile
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest

from helpers.places import ROOT

NOBODY = 65534
MAKE = "import gymnasium, dcgrid_env; gymnasium.make('dcgrid/Toy6-v0').reset(seed=0)"
ONE_KERNEL = (
    "import numpy as np; from dcgrid_env.core.random import keys; "
    "keys(np.uint64(1), np.zeros(1, np.uint64), np.zeros(1, np.uint64))"
)


class Environment:
    """A virtual environment that reads the packages of this one, and a copy of the tree to install in it."""

    def __init__(self, folder):
        self.folder, self.source = folder, folder / "source"
        self.bin = folder / "venv" / "bin"
        self.elsewhere = folder / "elsewhere"
        self.elsewhere.mkdir()
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder / "venv"], check=True)
        self.site, *_ = (folder / "venv").glob("lib/python*/site-packages")
        shared = {*site.getsitepackages(), *(path for path in sys.path if path.endswith("site-packages"))}
        (self.site / "shared.pth").write_text("\n".join(sorted(shared)))
        tool = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
        for part in tool["package-dir"].values():
            shutil.copytree(
                ROOT / part, self.source / part, ignore=shutil.ignore_patterns("__pycache__"), dirs_exist_ok=True
            )
        for name in ("pyproject.toml", "README.md", "LICENSE"):
            shutil.copy(ROOT / name, self.source)

    def install(self, *options):
        pip = [sys.executable, "-m", "pip", "--python", self.bin / "python", "install", "--quiet"]
        # The build needs setuptools 77, which pip fetches where this environment has an older one.
        major, *_ = version("setuptools").split(".")
        built_here = ["--no-build-isolation"] if int(major) >= 77 else []
        subprocess.run([*pip, "--no-deps", *built_here, *options, self.source], check=True)

    def run(self, *command, **variables):
        env = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"} | variables
        done = subprocess.run(command, env=env, cwd=self.elsewhere, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done

    def python(self, code, before=(), **variables):
        return self.run(*before, self.bin / "python", "-c", code, **variables)


@pytest.fixture
def environment():
    """An environment in a folder that other users can read."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        yield Environment(folder)


@pytest.mark.slow
def test_an_editable_installation_after_a_wheel_that_was_used(environment):
    environment.install()
    environment.python(MAKE)
    environment.install("--editable")
    assert not (environment.site / "dcgrid_env").exists()
    assert "ieee33-weak" in environment.run(environment.bin / "dcgrid", "list").stdout
    environment.python(MAKE)


@pytest.mark.slow
def test_another_user_runs_a_wheel_that_root_installed(environment):
    if not hasattr(os, "geteuid") or os.geteuid() != 0 or not shutil.which("setpriv"):
        pytest.skip("needs root and setpriv to run as another user")
    other = ("setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups")
    if subprocess.run([*other, environment.bin / "python", "-c", "import numba"], capture_output=True).returncode:
        pytest.skip("another user cannot read the packages of this environment")
    environment.install()
    temporary = environment.folder / "temporary"
    temporary.mkdir()
    temporary.chmod(0o1777)
    place = {"HOME": "/nonexistent", "XDG_CACHE_HOME": "/nonexistent", "TMPDIR": str(temporary), "NUMBA_CACHE_DIR": ""}

    def stderr(code, word="NUMBA_CACHE_DIR"):
        return [line for line in environment.python(code, other, **place).stderr.splitlines() if word in line]

    # Two lines where kernels are compiled and the folder cannot be written, then nothing: the code is there.
    folder = temporary / f"dcgrid-kernels-{NOBODY}"
    unwritable, compiling = sorted(stderr(MAKE, "dcgrid: "))
    assert unwritable.startswith("dcgrid: /nonexistent/dcgrid/kernels: ")
    assert f"using {folder}; set NUMBA_CACHE_DIR to a writable folder" in unwritable
    assert compiling.startswith("dcgrid: compiling kernels, once per installation")
    assert any(folder.iterdir())
    assert stderr(MAKE, "dcgrid: ") == []

    # A folder of root can be read and not written. One that others could have filled is not read.
    shutil.rmtree(folder)
    folder.mkdir()
    assert "kernels are compiled again by each process" in stderr(ONE_KERNEL)[-1]
    folder.chmod(0o777)
    os.chown(folder, NOBODY, NOBODY)
    assert "kernels are compiled again by each process" in stderr(ONE_KERNEL)[0]
    assert not any(folder.iterdir())
