"""Names that other packages add through entry points: good ones, broken ones, and names that are taken."""

import json
import os
import subprocess
import sys
import tomllib
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from dcgrid_env import FEEDER_REGISTRY, SCENARIO_REGISTRY
from dcgrid_env.baselines import CONTROLLER_REGISTRY
from dcgrid_env.devices import DEVICE_REGISTRY

PYPROJECT = Path(__file__).parents[3] / "pyproject.toml"
REGISTRIES = (CONTROLLER_REGISTRY, SCENARIO_REGISTRY, FEEDER_REGISTRY, DEVICE_REGISTRY)
GROUPS = {registry.group: registry for registry in REGISTRIES}
BATTERY = Path(__file__).parents[1] / "devices" / "battery.py"

GOOD = """
from dataclasses import replace
from dcgrid_env import load_feeder, make_scenario
from dcgrid_env.baselines import NoControl

class Law(NoControl): ...

CONTROLLERS = {"toy-law": ("the toy's law", Law), ".toy": ("a toy's file", lambda path: Law())}
SCENARIOS = {"toy-day": ("a day of the toy", lambda: make_scenario("toy6", name="toy-day"))}
FEEDERS = {
    "toy-net": ("the toy's feeder", lambda: load_feeder("toy6")),
    "toy-far": ("the toy's far feeder", lambda: replace(load_feeder("toy6"), name="toy-far")),
}
"""
GOOD_POINTS = """
[dcgrid.controllers]
all = good_toy:CONTROLLERS
[dcgrid.scenarios]
all = good_toy:SCENARIOS
[dcgrid.feeders]
all = good_toy:FEEDERS
"""


@pytest.fixture
def site(tmp_path):
    """A folder of installed distributions."""

    def install(name, module, points):
        (tmp_path / f"{name.replace('-', '_')}.py").write_text(module)
        about = tmp_path / f"{name.replace('-', '_')}-1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (about / "entry_points.txt").write_text(points)
        return tmp_path

    return install


def python(folder, *arguments):
    """Run Python where a folder's distributions are installed: the process as it ended."""
    own = dict(os.environ) | {"PYTHONPATH": str(folder), "COLUMNS": "300"}
    return subprocess.run([sys.executable, *arguments], env=own, cwd=folder, capture_output=True, text=True)


def printed(folder, code):
    """What a program prints; it must end well and say nothing else."""
    done = python(folder, "-W", "error", "-c", code)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return done.stdout.split()


def commands(folder, *lines):
    """Run command lines one after the other where a folder's distributions are installed, in one process.

    The status, the output and the errors of each.
    """
    code = (
        "import contextlib, io, json, sys\nfrom dcgrid_env.cli.main import main\nended = []\n"
        "for line in json.loads(sys.argv[1]):\n"
        "    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:\n"
        "        try: main(line.split()); status = 0\n"
        "        except SystemExit as end: status = end.code\n"
        "    ended.append([status, out.getvalue(), err.getvalue()])\n"
        "print(json.dumps(ended))"
    )
    done = python(folder, "-c", code, json.dumps(lines))
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
def test_a_package_adds_a_controller_a_scenario_and_a_feeder(site):
    folder = site("good-toy", GOOD, GOOD_POINTS)
    code = (
        "from dcgrid_env import *\nfrom dcgrid_env.baselines import *\n"
        "s = make_scenario('toy-day', split='test', horizon=2)\nopen('a.toy', 'w').close()\n"
        "c = find_controller('toy-law', s)\nf = find_controller('a.toy', s)\n"
        "print(s.name, load_feeder('toy-net').name, type(c).__name__, type(f).__name__)"
    )
    listed = python(folder, "-W", "error", "-c", f"{code}\nfrom dcgrid_env.cli.main import main\nmain(['list'])")
    assert (listed.returncode, listed.stderr) == (0, "")
    assert listed.stdout.splitlines()[0] == "toy-day toy6 Law Law"
    for line in (
        "toy-law the toy's law (good-toy 1.0)",
        "toy-day a day of the toy (good-toy 1.0)",
        "toy-net the toy's feeder (good-toy 1.0)",
    ):
        assert line in [" ".join(text.split()) for text in listed.stdout.splitlines()]
    assert ".toy" not in listed.stdout  # that is an ending, no name


@pytest.mark.slow
def test_a_scenario_takes_the_name_of_another_packages_feeder(site):
    folder = site("good-toy", GOOD, GOOD_POINTS)
    (folder / "toy-far").mkdir()  # a name goes before a folder, and the name is no file that may change
    (folder / "far.toml").write_text("base = 'toy6'\nfeeder = 'toy-far'\n")
    code = (
        "from dcgrid_env import *\nfrom dcgrid_env.scenario.serialization import reads_files, to_data\n"
        "s = make_scenario('toy6', feeder='toy-far')\n"
        "print(s.feeder is load_feeder('toy-far'), to_data(s.feeder), reads_files('feeder', 'toy-far'))\n"
        "print(make_scenario('far.toml').feeder is s.feeder)\n"
        "try: make_scenario('toy6', feeder='toy-near')\nexcept ValueError as error: print('toy-far' in str(error))"
    )
    assert printed(folder, code) == ["True", "toy-far", "False", "True", "True"]


DEVICES = """
DEVICES = {"battery": ("batteries", Batteries), "no-class": ("a slip", len), "dynamo": ("another slip", Batteries)}
"""
WITH_BATTERY = """
base = "toy6"
horizon = 3
[[devices]]
kind = "datacenter"
count = 1
p_rated_kw = 100.0
s_rated_share = 1.0
q_max_share = 0.3
[[devices]]
kind = "battery"
buses = ["2"]
p_rated_kw = 10.0
energy_kwh = 5.0
"""


@pytest.mark.slow
def test_a_scenario_file_names_another_packages_kind_of_device(site):
    points = "[dcgrid.devices]\nall = stores_toy:DEVICES\n"
    folder = site("stores-toy", BATTERY.read_text() + DEVICES, points)
    (folder / "a.toml").write_text(WITH_BATTERY)
    slips = {"no-class": "is no class; give a class of devices", "dynamo": "its kind is 'battery'"}
    for slip in slips:
        (folder / f"{slip}.toml").write_text(WITH_BATTERY.replace('"battery"', f'"{slip}"'))
    ran, (_, listed, _), *refused = commands(
        folder, "run --scenario a.toml --controllers none", "list", *(f"run --scenario {slip}.toml" for slip in slips)
    )
    assert (ran[0], ran[2]) == (0, ""), ran[2]
    assert "battery batteries (stores-toy 1.0)" in [" ".join(text.split()) for text in listed.splitlines()]
    code = (
        "import sys\nfrom dcgrid_env import make_scenario\nmake_scenario('toy6')\nprint('stores_toy' in sys.modules)\n"
        "s = make_scenario('a.toml')\nprint(s.agents[1], make_scenario('toy6').replace(devices=s.devices).n_agents)\n"
        "s.to_toml('b.toml')\nprint(make_scenario('b.toml', name='a').difference(s))"
    )
    assert printed(folder, code) == ["False", "bat_0", "2", "None"]
    for (slip, why), (status, _, error) in zip(slips.items(), refused, strict=True):
        assert status == 2
        assert f"kind of device {slip!r} of stores-toy 1.0 cannot be used: " in error
        assert why in error
        assert len(error.splitlines()) == 1


@pytest.mark.slow
def test_a_broken_package_of_devices_is_one_warning_and_named_where_its_kind_is_missed(site):
    folder = site("broken-toy", "import not_there", "[dcgrid.devices]\nall = broken_toy:DEVICES\n")
    (folder / "a.toml").write_text(WITH_BATTERY)
    ran = python(folder, "-m", "dcgrid_env.cli", "run", "--scenario", "a.toml")
    warned, error = ran.stderr.splitlines()
    assert ran.returncode == 2
    assert "is left out: ModuleNotFoundError" in warned
    assert (
        "devices[1].kind is 'battery'; no kind of device 'battery'; `dcgrid list devices` lists all; entry point"
        in error
    )


@pytest.mark.slow
def test_nothing_is_loaded_before_it_is_asked_for(site):
    folder = site("good-toy", GOOD, GOOD_POINTS)
    loaded = "print([m for m in ('good_toy', 'dcgrid_env.agents', 'torch') if m in sys.modules])"
    code = (
        "import sys, dcgrid_env.cli.main\nfrom dcgrid_env import load_feeder, make_scenario\n"
        "make_scenario('toy6'); load_feeder('ieee33')\n"
        f"from dcgrid_env.baselines import make_controller\nmake_controller('droop')\n{loaded}\n"
        "s = make_scenario('toy6')\nmake_controller('ppo', s)\nprint('good_toy' in sys.modules, 'torch' in sys.modules)"
    )
    assert printed(folder, code) == ["[]", "False", "False"]


BROKEN = {
    "no-module": ("import not_there", "ModuleNotFoundError: No module named 'not_there'"),
    "leaving": ("raise SystemExit(3)", "SystemExit: 3"),
    "a-list": ("THEIRS = ['broken-law']", "TypeError: it is of type list, not a mapping of names"),
    "no-pairs": ("THEIRS = {'law': print}", "TypeError: 'law' has no pair of what it is (a text) and what makes it"),
    "no-name": ("OTHER = {}", "AttributeError: module 'no_name' has no attribute 'THEIRS'"),
}
"""Modules of distributions, and what is wrong with each."""


@pytest.mark.slow
def test_a_broken_one_is_one_line_and_stops_nobody_else(site):
    for name, (module, _) in BROKEN.items():
        site(name, module, f"[dcgrid.controllers]\nlaws = {name.replace('-', '_')}:THEIRS\n")
    folder = site("good-toy", GOOD, GOOD_POINTS)
    code = (
        "from dcgrid_env.cli.main import main\nmain(['list'])\n"
        "main(['run', '--scenario', 'toy6', '--controllers', 'broken-law'])"
    )
    asked = python(folder, "-c", code)
    assert "toy-law" in asked.stdout
    assert asked.returncode == 2
    *lines, error = asked.stderr.splitlines()
    assert len(lines) == len(BROKEN)
    # Who asks for what one of them would have had is told of it on the line of the error.
    assert error.startswith("dcgrid: no controller 'broken-law'; ")
    for line, name in zip(lines, sorted(BROKEN), strict=True):
        where = f"entry point 'laws' (dcgrid.controllers, {name.replace('-', '_')}:THEIRS) of {name} 1.0"
        assert f"{where} is left out: {BROKEN[name][1]}" in line
        assert line.endswith("; mend or uninstall it")
        assert where in error


@pytest.mark.slow
def test_a_name_that_is_taken_stays_what_it_is(site):
    site("other-toy", GOOD.replace("Law", "Other"), GOOD_POINTS.replace("good_toy", "other_toy"))
    entries = "dict.fromkeys(['droop', 'toy-law', 'free'], ('', NoControl))"
    site(
        "taking-toy",
        f"from dcgrid_env.baselines import NoControl\nTHEIRS = {entries}",
        "[dcgrid.controllers]\nlaws = taking_toy:THEIRS\n",
    )
    folder = site("good-toy", GOOD, "[dcgrid.scenarios]\nall = good_toy:SCENARIOS\n")
    code = (
        "from dcgrid_env.baselines import *\n"
        "names = ('droop', 'toy-law', 'free')\n"
        "print(*(type(make_controller(name)).__name__ for name in names), 'ppo' in CONTROLLER_REGISTRY)"
    )
    done = python(folder, "-c", code)
    assert done.stdout.split() == ["Droop", "Other", "NoControl", "True"]
    (line,) = done.stderr.splitlines()
    assert "of taking-toy 1.0 repeats droop, toy-law, which stays what it is; give it another name" in line


@pytest.mark.slow
def test_one_that_makes_nothing_useful_is_one_line(site):
    points = "[dcgrid.controllers]\nlaws = bad_toy:THEIRS\n[dcgrid.scenarios]\nall = bad_toy:THEIRS\n"
    folder = site("bad-toy", "THEIRS = {'fails': ('', lambda: 1 / 0), 'empty': ('', dict)}", points)
    code = (
        "from dcgrid_env import make_scenario\nfrom dcgrid_env.baselines import make_controller\n"
        "for make in (make_controller, make_scenario):\n for name in ('fails', 'empty'):\n"
        "  try: make(name)\n  except ValueError as error: print(error)"
    )
    assert " ".join(printed(folder, code)) == " ".join(
        f"{kind} 'fails' of bad-toy 1.0 cannot be made: ZeroDivisionError: division by zero; mend or uninstall it "
        f"{kind} 'empty' of bad-toy 1.0 is of type dict and no {kind.capitalize()}; mend it"
        for kind in ("controller", "scenario")
    )


def test_ours_are_declared_too_and_hand_over_what_is_registered():
    declared = tomllib.loads(PYPROJECT.read_text())["project"]["entry-points"]
    assert set(declared) == set(GROUPS)
    for group, points in declared.items():
        for value in points.values():
            module, _, name = value.partition(":")
            for entry in getattr(import_module(module), name):
                assert entry in GROUPS[group]
        installed = {p.name: p.value for p in entry_points(group=group) if p.dist and p.dist.name == "dcgrid-env"}
        assert installed == points, "the installed metadata is older than pyproject.toml: install the package again"
