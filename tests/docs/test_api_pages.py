"""The API reference contains every public name once, and its overview lists every page."""

import re
import runpy
import sys
from importlib import import_module

import pytest

from helpers.places import ROOT

pytest.importorskip("sphinx")
EXTENSIONS = ROOT / "docs" / "extensions"
PACKAGES = ("dcgrid_env", "dcgrid_env.baselines", "dcgrid_env.agents", "dcgrid_env.traces", "dcgrid_env.rendering")
DIRECTIVE = re.compile(r"^\.\. (?:autoclass|autofunction|py:data):: (.+)$", re.MULTILINE)
LINK = re.compile(r":py:obj:`~(.+?)`")


@pytest.fixture
def api(monkeypatch):
    monkeypatch.syspath_prepend(str(EXTENSIONS))
    yield runpy.run_path(str(EXTENSIONS / "api_pages.py"))
    sys.modules.pop("public_names", None)


def documented_on(text):
    """Full names that a page documents; the name of a constant is within the page's package."""
    (package,) = re.findall(r"^\.\. currentmodule:: (.+)$", text, re.MULTILINE)
    return [name if "." in name else f"{package}.{name}" for name in DIRECTIVE.findall(text)]


def named(public):
    """What users import under a full name."""
    package, _, name = public.rpartition(".")
    return getattr(import_module(package), name)


@pytest.mark.slow
def test_every_public_name_is_on_one_page(api):
    pages = {module: api["page"](module, names) for module, names in api["modules"]().items()}
    documented = [public for text in pages.values() for public in documented_on(text)]
    for package in PACKAGES:
        for name in import_module(package).__all__:
            same = [
                public
                for public in documented
                if public.endswith(f".{name}") and named(public) is named(f"{package}.{name}")
            ]
            assert len(same) == (name != "__version__"), f"{package}.{name} is documented as {same}"
    for module, text in pages.items():
        about = import_module(module).__doc__ or ""
        assert text.index(about.split(".")[0].split("\n")[0]) < text.index(".. list-table::")
        assert LINK.findall(text) == documented_on(text)  # the table at the top has all names of the page
    assert sorted(LINK.findall(api["index"]())) == sorted(documented)
    assert ".. index:: ! make_vec\n" in pages["dcgrid_env.envs.vector"]  # Gymnasium's name leads to the class


@pytest.mark.slow
def test_every_public_name_has_a_description(api):
    names = [(module, public) for module, names in api["modules"]().items() for public in names]
    assert [public for module, public in names if not api["described"](module, public)] == []


@pytest.mark.slow
def test_groups_cover_all_modules(api):
    groups = {module: api["place"](module) for module in api["modules"]()}
    entries = {(group.title, i) for group, i in groups.values()}
    assert entries == {(group.title, i) for group in api["GROUPS"] for i in range(len(group.modules))}
    assert groups["dcgrid_env.baselines.laws.droop"][0].title == "Write a controller"
    assert groups["dcgrid_env.baselines.score"][0].title == "Score and compare"  # not that of its package
    with pytest.raises(ValueError, match=r"module 'dcgrid_env.new' belongs to no group; add it to GROUPS"):
        api["place"]("dcgrid_env.new")
    with pytest.raises(ValueError, match=r"'dcgrid_env.scenarios' belongs to no group"):
        api["place"]("dcgrid_env.scenarios")
