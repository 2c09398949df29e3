"""The package list and the folders agree."""

import tomllib
from importlib.metadata import version
from pathlib import Path

import dcgrid_env

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_every_package_is_listed():
    tool = PROJECT["tool"]["setuptools"]
    folders = tool["package-dir"]
    found = set()
    for package, folder in folders.items():
        for init in (ROOT / folder).rglob("__init__.py"):
            found.add(".".join([package, *init.parent.relative_to(ROOT / folder).parts]))
    assert set(tool["packages"]) == found


def test_versions_agree():
    assert dcgrid_env.__version__ == PROJECT["project"]["version"] == version("dcgrid-env")


def test_the_type_checker_follows_the_mapping():
    for name in ("baselines", "agents", "traces"):
        link = ROOT / "tests" / "typings" / "dcgrid_env" / name
        assert link.resolve() == ROOT / name


def test_names_that_are_modules_too_stay_functions():
    import dcgrid_env.env
    import dcgrid_env.parallel_env

    assert callable(dcgrid_env.env)
    assert callable(dcgrid_env.parallel_env)
