"""Rooms stand in one order and import runs one way through it; importing the package is light."""

import ast
import subprocess
import sys
from collections import defaultdict
from functools import cache
from graphlib import CycleError, TopologicalSorter
from importlib import import_module

import pytest

from helpers.places import ROOT

ROOMS = ("core", "traces", "grid", "powerflow", "devices", "scenario", "engine", "rendering", "envs")
"""Each room may import those before it, and itself; then comes what the package gives under its own name."""
ABOVE = ("", "baselines", "agents", "cli", "command", "apps")
"""These use public names: of the package, of its rooms, and all of core and of traces. Nothing else imports apps."""
STUDIES = "studies"
"""docs/studies, which is not installed: it may import everything, and nothing imports it."""
ORDER = (*ROOMS, *ABOVE, STUDIES)
FOLDERS = {"dcgrid_env": "dcgrid_env", "baselines": "dcgrid_env.baselines", "agents": "dcgrid_env.agents"}
FOLDERS |= {"traces": "dcgrid_env.traces", "apps": "dcgrid_env.apps", "docs/studies": "docs.studies"}
FOR_ALL = ("core", "traces", "baselines")
ON_TENSORS = (
    "dcgrid_env.core.torch_threads",
    "dcgrid_env.powerflow.balanced.implicit",
    "dcgrid_env.powerflow.unbalanced.sweep_tensors",
)
"""Imported by who is given torch tensors, and so has torch already."""
YET_TO_MEND: set[str] = set()
"""Modules that break a rule of this file since before it was written; each leaves this list as it is mended."""


def found_modules():
    for folder, package in FOLDERS.items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            dotted = ".".join([package, *path.relative_to(ROOT / folder).with_suffix("").parts])
            yield dotted.removesuffix(".__init__"), path


MODULES = dict(found_modules())


@cache
def imported(path):
    """Dotted names that a file imports, those for the type checker too: they tie rooms as others do."""
    names = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


def room_of(dotted):
    room = dotted.partition(".")[2].partition(".")[0]
    return room if room in ORDER else ""


def module_of(dotted):
    """Return the module that a dotted name is or belongs to."""
    module = dotted
    while module not in MODULES:
        assert module, f"{dotted} is in no known module"
        module = module.rpartition(".")[0]
    return module


def own_imports(path):
    return [target for target in imported(path) if target.split(".")[0] in ("dcgrid_env", "docs")]


def test_every_folder_is_a_room_of_the_plan():
    assert {room_of(name) for name in MODULES} == set(ORDER)
    flat = {path.name for path in (ROOT / "dcgrid_env").glob("*.py")}
    assert flat == {"__init__.py"}


@pytest.mark.slow
def test_no_upward_import():
    bad = [
        f"{name} imports {target}, which stands above it"
        for name in MODULES.keys() - YET_TO_MEND
        for target in own_imports(MODULES[name])
        if ORDER.index(room_of(target)) > ORDER.index(room_of(name))
    ]
    assert not bad, bad


@pytest.mark.slow
def test_no_circle():
    """At no level: the files and folders of each folder import each other one way."""
    levels = defaultdict(lambda: defaultdict(set))
    for name, path in MODULES.items():
        if path.name == "__init__.py" or name in YET_TO_MEND:
            continue  # hands names on
        for target in map(module_of, own_imports(path)):
            here, there = name.split("."), target.split(".")
            if MODULES[target].name == "__init__.py":
                there.append("__init__")
            shared = next(i for i, (a, b) in enumerate(zip(here, there, strict=False)) if a != b)
            levels[".".join(here[:shared])][here[shared]].add(there[shared])
    for folder, graph in levels.items():
        try:
            list(TopologicalSorter(graph).static_order())
        except CycleError as error:
            pytest.fail(f"{folder}: {' <- '.join(error.args[1])}")


def test_torch_and_sb3_are_imported_in_agents_only():
    heavy = {
        name
        for name, path in MODULES.items()
        if {target.split(".")[0] for target in imported(path)} & {"torch", "stable_baselines3"}
    }
    assert {name for name in heavy if room_of(name) not in ("agents", STUDIES)} == set(ON_TENSORS)


@pytest.mark.parametrize("room", ["baselines", "agents"])
def test_controllers_use_public_names_only(room):
    names = {name for name in MODULES.keys() - YET_TO_MEND if not name.endswith("_command")}
    for name in sorted(name for name in names if room_of(name) == room):
        for target in own_imports(MODULES[name]):
            if room_of(target) in (*FOR_ALL, room):
                continue
            owner, _, public = target.rpartition(".")
            assert owner == "dcgrid_env" or room_of(owner) == owner.removeprefix("dcgrid_env."), (
                f"{name} imports {target}"
            )
            assert public in import_module(owner).__all__, f"{name} imports {target}, which is not public"


@pytest.mark.parametrize("name", ["dcgrid_env", "dcgrid_env.agents", "dcgrid_env.cli.main"])
@pytest.mark.slow
def test_import_is_light(name):
    heavy = ("torch", "stable_baselines3", "matplotlib", "pandas", "numba")
    code = f"import sys, {name}; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
