"""Controllers as the command line names them."""

import inspect
import sys
from pathlib import Path

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.agents import Network, Policy
from dcgrid_env.agents.policy.guard import GuardedPolicy
from dcgrid_env.baselines import Droop, find_controller, rollout

MODULE = """
from dataclasses import dataclass

import numpy as np


@dataclass
class Still:
    q: float = 0.25

    def reset(self, env_info):
        self.n = 2 * env_info.datacenters.count + env_info.inverters.count

    def act(self, observations):
        return np.full((*np.shape(observations)[:-1], self.n), self.q)


class Needy:
    def __init__(self, gain): ...


class Leaving:
    def __init__(self):
        raise SystemExit(0)


class Idle: ...


number = 3
"""


@pytest.fixture
def toy6():
    return make_scenario("toy6", split="test", horizon=5)


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A working directory with a user's module and package, forgotten afterwards."""
    (tmp_path / "own").mkdir()
    for name in ("mine.py", "own/laws.py"):
        (tmp_path / name).write_text(MODULE)
    (tmp_path / "broken.py").write_text("def f(:\n")
    (tmp_path / "leaving.py").write_text("import sys\nsys.exit(0)\n")
    (tmp_path / "missing.py").write_text("import a_module_that_is_not_there\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        # Not what they import besides: numba, say, cannot be imported twice.
        if Path(getattr(sys.modules[name], "__file__", None) or "/").is_relative_to(tmp_path) or name == "own":
            del sys.modules[name]


def test_names_modules_files_and_policies(here, toy6):
    assert isinstance(find_controller("droop", toy6), Droop)
    Policy({"joint": Network([(np.zeros((23, 4)), np.full(4, 0.25))])}).save("p")
    with_q = []
    for spec in ("own.laws:Still", "mine:Still", "mine.py:Still", f"{here / 'own' / 'laws.py'}:Still", "p.safetensors"):
        recorder = rollout(toy6, find_controller(spec, toy6), [0])
        with_q.append(recorder.series(0).q_kvar)
    assert with_q[0].any()
    for other in with_q[1:]:
        np.testing.assert_array_equal(other, with_q[0])


def test_the_folder_of_a_training_run_names_its_policy(here, toy6):
    path = Policy({"joint": Network([(np.zeros((23, 4)), np.full(4, 0.25))])}).save("run/policy")
    for spec in ("run", "run/", str(path.absolute().parent), "guarded:run"):
        found = find_controller(spec, toy6)
        inner = found.policy if isinstance(found, GuardedPolicy) else found
        assert isinstance(inner, Policy)
        assert inner.sha256 == Policy.load(path).sha256
    (here / "droop").mkdir()
    assert isinstance(find_controller("droop", toy6), Droop)  # a name is a name, whatever stands in the folder


def test_a_file_is_read_anew(here, toy6):
    assert find_controller("mine.py:Still", toy6).q == 0.25  # pyright: ignore[reportAttributeAccessIssue]
    (here / "mine.py").write_text(MODULE.replace("0.25", "0.5"))
    assert find_controller("mine.py:Still", toy6).q == 0.5  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("pid", r"no controller 'pid'; `dcgrid list controllers` lists all; or give package.module:Class"),
        ("nowhere.py:Still", "'nowhere.py:Still': there is no file nowhere.py; give the path of one"),
        ("no.such:Still", "importing no.such fails: ModuleNotFoundError: No module named 'no'"),
        ("broken.py:Still", "importing broken.py fails: SyntaxError"),
        (
            "missing.py:Still",
            "importing missing.py fails, missing.py line 1: ModuleNotFoundError: .*a_module_that_is_not_there",
        ),
        ("leaving.py:Still", "importing leaving.py fails, leaving.py line 2: SystemExit: 0"),
        ("leaving:Still", "importing leaving fails, leaving.py line 2: SystemExit: 0"),
        ("mine.py:Leaving", "constructing it without arguments fails, mine.py line 24: SystemExit: 0"),
        ("mine.py:Moving", "has no 'Moving'; it has Still, Needy, Leaving, Idle"),
        ("mine.py:number", "'number' of mine.py is no class"),
        ("mine.py:Needy", "constructing it without arguments fails: TypeError: .*gain"),
        ("mine.py:Idle", "Idle is no controller; give it reset and act"),
        ("nowhere.safetensors", "'nowhere.safetensors': there is no file nowhere.safetensors; give"),
        ("own", "'own': there is no file own/policy.safetensors; give .*, or the folder of a training run"),
    ],
)
def test_what_names_no_controller(here, toy6, spec, message):
    with pytest.raises(ValueError, match=message):
        find_controller(spec, toy6)


def test_constructor_arguments(here, toy6):
    assert find_controller("mine.py:Still(q=0.5)", toy6).q == 0.5  # pyright: ignore[reportAttributeAccessIssue]
    assert find_controller("mine:Still(-1)", toy6).q == -1  # pyright: ignore[reportAttributeAccessIssue]
    found = find_controller("mine.py:Still(q=[1, {'a': fast}])".replace("'a': fast", "'a': 2"), toy6)
    assert found.q == [1, {"a": 2}]  # pyright: ignore[reportAttributeAccessIssue]
    assert find_controller("mine.py:Still(q=fast)", toy6).q == "fast"  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize(
    "arguments", ["(q=1 + 1)", "(q=open('x'))", "(q=", "(**{'q': 1})", "(q=1) + (2)", "(q=1, q=2)"]
)
def test_arguments_are_read_and_never_run(here, toy6, arguments):
    with pytest.raises(ValueError, match=r"the arguments cannot be read \(.*give literals|no controller"):
        find_controller(f"mine.py:Still{arguments}", toy6)


def test_a_file_is_imported_once(here, toy6, capsys):
    (here / "mine.py").write_text(MODULE + "\nprint('imported')\n")
    for _ in range(3):
        find_controller("mine.py:Still", toy6)
        find_controller(str(here / "mine.py") + ":Still(q=1.0)", toy6)
    assert capsys.readouterr().out == "imported\n"


def test_two_files_of_one_name_stay_apart(here, toy6):
    first = find_controller("mine.py:Still", toy6)
    (here / "own" / "mine.py").write_text(MODULE.replace("0.25", "0.5"))
    other = find_controller("own/mine.py:Still", toy6)
    for controller, file in ((first, "mine.py"), (other, "own/mine.py")):
        assert inspect.getfile(type(controller)) == str(here / file)
