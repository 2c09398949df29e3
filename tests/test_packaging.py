"""The package list and the folders agree."""

import subprocess
import tomllib
from fnmatch import fnmatch
from importlib.metadata import version
from pathlib import Path

import pytest

import dcgrid_env
from helpers.places import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


TOOL = PROJECT["tool"]["setuptools"]


def tracked():
    """Files of the installed packages: (package, name), of those that git knows."""
    packages = {Path(folder): package for package, folder in TOOL["package-dir"].items()}
    listed = subprocess.run(["git", "ls-files", "-z", *packages], cwd=ROOT, capture_output=True, text=True, check=True)
    for path in map(Path, filter(None, listed.stdout.split("\0"))):
        folder = next(parent for parent in path.parents if parent in packages)
        yield ".".join([packages[folder], *path.relative_to(folder).parent.parts]), path.name


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="not a clone: git does not say which files there are")
def test_every_folder_is_listed_those_of_data_too():
    assert set(TOOL["packages"]) == {package for package, _ in tracked()}


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="not a clone: git does not say which files there are")
def test_every_file_of_data_is_installed():
    patterns = TOOL["package-data"]
    assert set(patterns) <= set(TOOL["packages"])
    data = [(package, name) for package, name in tracked() if not name.endswith(".py")]
    left_out = {name for package, name in data if not any(fnmatch(name, p) for p in patterns.get(package, ()))}
    assert left_out == {"README.md"}  # of traces, which is for readers of the repository
    assert len(data) > 50


def test_versions_agree():
    assert dcgrid_env.__version__ == PROJECT["project"]["version"] == version("dcgrid-env")


def test_the_type_checker_follows_the_mapping():
    for name in ("baselines", "agents", "traces"):
        link = ROOT / "tests" / "typings" / "dcgrid_env" / name
        assert link.resolve() == ROOT / name
