"""Imports run one way, and importing the package is light."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# Each module or package may import those before it, and its own package.
ORDER = """
    units install seeds arrays files lock cache traces feeder powerflow devices fault scenario_check plain_data scenario
    presets constants dynamics observation reward delay request_delay counter trace_pool episode foresight fingerprint
    tensor_env simulation metrics layout history lettering panels episode_curves render info actions plain_spec
    time_limit face env vector_env parallel_env baselines agents figure study yardsticks benchmark learning commands
    timing speed_tensors speed cli
""".split()  # noqa: SIM905 (a list of strings would be longer than the page is wide)
FOLDERS = {"dcgrid_env": "dcgrid_env", "baselines": "dcgrid_env.baselines", "agents": "dcgrid_env.agents"}
FOLDERS |= {"traces": "dcgrid_env.traces"}


FOR_ALL = ("files", "lock")
"""No part of the environment: writing files and locking folders, for whoever writes."""
ON_TENSORS = ("dcgrid_env.powerflow.implicit",)
"""Imported by who is given torch tensors, and so has torch already."""


def modules():
    for folder, package in FOLDERS.items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            dotted = ".".join([package, *path.relative_to(ROOT / folder).with_suffix("").parts])
            yield dotted.removesuffix(".__init__"), path


def imported(path):
    """Dotted names that a file imports, except those for the type checker alone."""
    tree = ast.parse(path.read_text())
    guarded = {
        id(node)
        for block in ast.walk(tree)
        if isinstance(block, ast.If) and ast.unparse(block.test) == "TYPE_CHECKING"
        for node in ast.walk(block)
    }
    for node in ast.walk(tree):
        if id(node) in guarded:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def part_of(dotted):
    return dotted.partition(".")[2].partition(".")[0]


def test_every_module_has_its_place_in_the_order():
    assert {part_of(name) for name, _ in modules()} - {""} == set(ORDER)


@pytest.mark.parametrize(("name", "path"), list(modules()), ids=[name for name, _ in modules()])
def test_no_upward_import(name, path):
    if name == "dcgrid_env":
        return  # gathers the public names
    own = ORDER.index(part_of(name))
    for target in imported(path):
        if not target.startswith("dcgrid_env"):
            continue
        part = part_of(target)
        if part not in ORDER:
            # A public name of the package itself: for what stands above the environments.
            assert own >= ORDER.index("baselines"), f"{name} imports {target} from the package itself"
            continue
        assert ORDER.index(part) <= own, f"{name} imports {target}, which stands above it"


@pytest.mark.parametrize(("name", "path"), list(modules()), ids=[name for name, _ in modules()])
def test_torch_and_sb3_are_imported_in_agents_only(name, path):
    heavy = {target.split(".")[0] for target in imported(path)} & {"torch", "stable_baselines3"}
    assert not heavy or part_of(name) in ("agents", "speed", "speed_tensors") or name in ON_TENSORS


@pytest.mark.parametrize(("name", "path"), [m for m in modules() if part_of(m[0]) in ("baselines", "agents")])
def test_controllers_use_public_names_only(name, path):
    import dcgrid_env

    for target in imported(path):
        if target.startswith("dcgrid_env") and part_of(target) not in ("baselines", "agents", *FOR_ALL):
            public = target.removeprefix("dcgrid_env.")
            assert public in dcgrid_env.__all__, f"{name} imports {target}, which is not public"


@pytest.mark.parametrize("name", ["dcgrid_env", "dcgrid_env.agents", "dcgrid_env.cli"])
def test_import_is_light(name):
    heavy = ("torch", "stable_baselines3", "matplotlib", "pandas", "numba")
    code = f"import sys, {name}; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
