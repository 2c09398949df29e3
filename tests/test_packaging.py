"""The package list and the folders agree."""

import re
import subprocess
import tomllib
from fnmatch import fnmatch
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml

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


def test_version_and_date_of_the_release_are_the_same_everywhere():
    assert dcgrid_env.__version__ == version("dcgrid-env")
    released = re.search(r"^## ([\d.]+) - ([\d-]+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    cited = dict(re.findall(r"^(version|date-released): (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE))
    assert released is not None
    assert released.groups() == (cited["version"], cited["date-released"])
    assert f"version = {{{released[1]}}}" in (ROOT / "README.md").read_text()
    assert dcgrid_env.__version__ == released[1]


def test_the_recipe_has_the_requirements_of_the_project():
    recipe = yaml.safe_load((ROOT / "docs" / "conda-recipe.yaml").read_text())
    renamed = {"matplotlib": "matplotlib-base", "docstring-parser": "docstring_parser"}
    needed = [re.fullmatch(r"([\w-]+)(>=.+)", each) for each in PROJECT["project"]["dependencies"]]
    expected = [f"{renamed.get(each[1], each[1])} {each[2]}" for each in needed if each]
    assert recipe["requirements"]["run"] == ["python >=${{ python_min }}", *expected]
    assert f">={recipe['context']['python_min']}" == PROJECT["project"]["requires-python"]
    assert recipe["context"]["version"] == dcgrid_env.__version__
    assert recipe["build"]["python"]["entry_points"] == [
        f"{name} = {target}" for name, target in PROJECT["project"]["scripts"].items()
    ]


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="not a clone: a source archive has no links")
def test_the_type_checker_follows_the_mapping():
    for name in ("baselines", "agents", "traces", "apps"):
        link = ROOT / "tests" / "typings" / "dcgrid_env" / name
        assert link.resolve() == ROOT / name
