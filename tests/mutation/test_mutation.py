"""The mutation run itself: on a toy package it finds what no test notices, catches the rest, and touches nothing."""

import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

HERE = Path(__file__).parent
ROOT = HERE.parents[1]

TOY = {
    "toy/__init__.py": "",
    "inner/__init__.py": "",
    "inner/figures.py": '''"""A toy; 1 < 2."""

TOP = 4


def clipped(value: "int | None") -> int:
    if value is None:
        raise TypeError(f"no value, {1 + 1}")
    return min(value, TOP)


def leading(value: int) -> int:
    while value > 1:
        value = value // 2
    return value
''',
    "tests/test_figures.py": """from toy.inner.figures import clipped, leading


def test_figures():
    assert [clipped(v) for v in (3, 9)] == [3, 4]
    assert [leading(v) for v in (1, 8, 9)] == [1, 1, 1]
""",
    "pyproject.toml": """[tool.setuptools.package-dir]
toy = "toy"
"toy.inner" = "inner"
""",
    "rooms.toml": """[rooms.figures]
modules = ["inner/*.py"]
tests = ["tests"]
""",
    "equivalents.toml": """[[equivalent]]
module = "inner/figures.py"
before = "while value > 1:"
after = "while value >= 1:"
reason = "planted: counted apart, not tried"
""",
}


@pytest.fixture
def toy(tmp_path):
    """A package with a folder mapped into it and a test that leaves one thing unasked: a value of None."""
    for name, text in TOY.items():
        path = tmp_path / "a tree" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "a tree"


@pytest.fixture
def tool(monkeypatch):
    """Return the tool's modules by name; they belong to a script and are not in a package."""
    monkeypatch.syspath_prepend(str(HERE))
    return import_module


def run(root, *arguments):
    lists = ["--rooms", root / "rooms.toml", "--equivalents", root / "equivalents.toml"]
    command = [sys.executable, HERE / "run.py", "--root", root, *lists, "--jobs", "2", "--grace", "1", *arguments]
    return subprocess.run([str(part) for part in command], capture_output=True, text=True, timeout=300)


def files(root):
    return {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_a_planted_survivor_is_found_and_planted_mutants_are_caught(toy, tmp_path):
    before = files(toy)
    done = run(toy, "--out", tmp_path / "outcomes.json", "--least", "95")
    assert files(toy) == before
    assert done.returncode == 1, done.stderr
    outcomes = json.loads((tmp_path / "outcomes.json").read_text())
    became = {(o["before"], o["after"]): o["what"] for o in outcomes}
    survivor = ('raise TypeError(f"no value, {1 + 1}")', "pass")
    assert [change for change, what in became.items() if what == "survived"] == [survivor]
    assert became["while value > 1:", "while value >= 1:"] == "equivalent"
    endless = [("value = value // 2", "pass"), ("while value > 1:", "while value <= 1:")]
    assert {change for change, what in became.items() if what == "timed out"} == set(endless)
    assert became["TOP = 4", "TOP = 5"] == "caught"
    assert {o["test"].split(" - ")[0] for o in outcomes if o["what"] == "caught"} == {
        "FAILED tests/test_figures.py::test_figures"
    }
    n = len(outcomes)
    assert f"FIGURES {n} {n} 1 {n - 4} 2 1 " in " ".join(done.stdout.split())
    assert f"--- inner/figures.py:8\n+++ survived\n@@ -1 +1 @@\n-{survivor[0]}\n+{survivor[1]}\n" in done.stdout
    assert "figures: fewer than 95 % are caught" in done.stdout
    again = run(toy, "--survivors", tmp_path / "outcomes.json", "--out", tmp_path / "again.json")
    assert again.returncode == 1
    assert [o["after"] for o in json.loads((tmp_path / "again.json").read_text())] == ["pass"]


@pytest.mark.slow
def test_a_run_that_cannot_be_made_says_why(toy):
    assert "no room 'figure' in rooms.toml; choose from figures" in run(toy, "figure").stderr
    listed = toy / "equivalents.toml"
    listed.write_text(TOY["equivalents.toml"].replace("> 1:", "> 3:"))
    done = run(toy)
    assert done.returncode == 2
    assert "equivalents.toml: inner/figures.py has no change to 'while value >= 1:'; remove it" in done.stderr
    listed.write_text("")
    (toy / "tests" / "test_figures.py").write_text(TOY["tests/test_figures.py"].replace("== [3, 4]", "== [3, 5]"))
    done = run(toy)
    assert done.returncode == 2
    assert "on the unchanged tree the tests failed: FAILED tests/test_figures.py::test_figures" in done.stderr


@pytest.mark.parametrize(
    ("source", "wanted"),
    [
        ("a = b < 2", ["a = b <= 2", "a = b >= 2", "a = b < 3"]),
        ("a = b is not c", ["a = b is c"]),
        ("a = (b) not in (c)", ["a = (b) in (c)"]),
        ("a = b + -0.5 * c", ["a = b - -0.5 * c", "a = b + 0.5 * c", "a = b + -1.0 * c", "a = b + -0.5 / c"]),
        ("a = max(b, 0.0)", ["a = min(b, 0.0)", "a = max(b, 1.0)"]),
        ("a = not b or c", ["a = b or c", "a = not b and c"]),
        ("a = b if c.d else True", ["a = b if not (c.d) else True", "a = b if c.d else False"]),
        ("if a and b:\n    c += 1", ["if not (a and b):", "if a or b:", "pass", "c -= 1", "c += 2"]),
        ("a: 'int | None' = 1", ["a: 'int | None' = 2"]),
        ("é = 1 + b", ["é = 2 + b", "é = 1 - b"]),
        ('a = f"{1 + 1}" + "x"', []),
        ("for a, b in zip(c, d, strict=True):\n    assert a < b", []),
        ("def f(a, b=1):\n    a = g(a)\n    return a", ["def f(a, b=2):", "pass"]),
        ("@f(1)\ndef g(a: int | None) -> int:\n    if a:\n        return 2\n    return 3",
         ["if not (a):", "pass", "return 3", "return 4"]),
    ],
)  # fmt: skip
def test_mutants_of_a_line(tool, source, wanted):
    assert sorted(m.after for m in tool("operators").mutants_of("m.py", source.encode())) == sorted(wanted)


def test_a_sample_is_that_of_its_seed(tool, toy):
    run_module, rooms = tool("run"), tool("rooms")
    (room,) = rooms.read_rooms(toy / "rooms.toml", toy, [])
    mutants = rooms.all_mutants(toy, room)

    def sample(seed):
        asked = run_module.argparse.Namespace(module=None, survivors=None, sample=6, seed=seed)
        return run_module._chosen(asked, room, mutants)

    assert sample(0) == sample(0) != sample(1)
    assert len(set(sample(0))) == 6


@pytest.mark.slow
def test_every_change_listed_as_equivalent_is_there(tool):
    rooms = tool("rooms")
    assert rooms.stale(ROOT, rooms.read_equivalents(HERE / "equivalents.toml")) == []


def test_tests_run_from_the_nearest_to_those_of_the_room(tool, toy):
    for name in ("inner/figures", "inner/other", "inner/against_opendss", "far", "room"):
        file = toy / "tests" / Path(name).with_name(f"test_{Path(name).name}.py")
        file.parent.mkdir(exist_ok=True)
        file.write_text("")
    near = {"inner": ("tests/test_far.py",)}
    room = tool("rooms").Room("figures", ("inner/figures.py", "inner/other.py"), ("tests/test_room.py",), near, False)
    rest = ["tests/test_far.py", "tests/test_room.py"]
    own, other = "tests/inner/test_figures.py", "tests/inner/test_other.py"
    assert room.asked(toy, "inner/figures.py") == [own, other, *rest]
    assert room.asked(toy, "inner/other.py") == [other, own, *rest]
    assert sorted(room.all_asked(toy)) == sorted([own, other, *rest])


def test_every_room_is_there(tool):
    found = tool("rooms").read_rooms(HERE / "rooms.toml", ROOT, [])
    assert [room.name for room in found] == ["powerflow", "devices", "engine", "reward"]
