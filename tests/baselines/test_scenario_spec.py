"""Scenarios as the command line names them."""

import pickle
import subprocess
import sys

import pytest

from dcgrid_env import CostWeights, Fault, PrefillDecodeDvfs, make_scenario, scenario_hash
from dcgrid_env.baselines.scenario_spec import ScenarioSpec, options_of, read_overrides, read_value, spec_of

OWN = """
from dcgrid_env import load_feeder, make_scenario

print("imported")


def make():
    print("made")
    return make_scenario("toy6", name="mine", horizon=20)


here = make_scenario("toy6", name="here")
number = 3


def fails():
    return {}["k"]


def other():
    return 3


def asks(horizon): ...
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    (tmp_path / "own.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        del sys.modules[name]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("60", 60),
        ("0.005", 0.005),
        ("-1e-3", -1e-3),
        ("true", True),
        ("null", None),
        ("prefill-decode", "prefill-decode"),
        ('"two words"', "two words"),
        ("two words", "two words"),
        ("ieee33-weak", "ieee33-weak"),
        ("[18, 33]", [18, 33]),
        ('["a", "b"]', ["a", "b"]),
        ("{backlog=1}", {"backlog": 1}),
        ('{"backlog": 1.5}', {"backlog": 1.5}),
        ('[{among=["inverter"], begin_s=[1, 2]}]', [{"among": ["inverter"], "begin_s": [1, 2]}]),
        ("2024-07-10", "2024-07-10"),
        ("1\nb = 2", "1\nb = 2"),
    ],
)
def test_values(text, value):
    found = read_value("field", text)
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (("horizon",), "set: 'horizon' is no field with its value; write FIELD=VALUE"),
        (("=60",), "is no field with its value"),
        (
            ("datacenters.p_rated_kw=[1,",),
            r"set: datacenters.p_rated_kw is '\[1,', which can be read neither as TOML nor as JSON; write",
        ),
        (("horizon=",), "set: horizon is ''"),
        (("horizon=60", "horizon=50"), "set: horizon is there twice, as 60 and as 50; give it once"),
        (("sensing.noise_pu=0.1", "sensing.noise_pu=0.2"), "set: sensing.noise_pu is there twice, as 0.1 and as 0.2"),
    ],
)
def test_what_is_no_override(texts, message):
    with pytest.raises(ValueError, match=message):
        read_overrides(texts)
    assert read_overrides(("name=60", "horizon=60")) == {"name": "60", "horizon": 60}


def test_a_preset_with_overrides(here):
    spec = ScenarioSpec("ieee33", ("horizon=60", "datacenters.p_rated_kw=[1, 2, 3, 4]", "feeder=ieee33"))
    found = spec.make("test", observe="feeder")
    expected = make_scenario(
        "ieee33", horizon=60, datacenters={"p_rated_kw": (1, 2, 3, 4)}, split="test", observe="feeder"
    )
    assert scenario_hash(found) == scenario_hash(expected)
    assert spec.make("test", observe="feeder") is found
    assert spec_of(found) == spec
    assert not spec.is_preset
    assert ScenarioSpec("ieee33").is_preset
    assert (
        spec.options("--scenario")
        == "--scenario ieee33 --set horizon=60 'datacenters.p_rated_kw=[1, 2, 3, 4]' feeder=ieee33"
    )
    assert options_of(expected, "--scenario") == "--scenario FILE.py:FUNCTION"


def test_tables_become_weights_and_faults(here):
    given = ("weights={backlog=1}", '[{among=["inverter"], begin_s=[1, 2]}]', "datacenters.clock_law=prefill-decode")
    found = ScenarioSpec("ieee33", (given[0], f"faults={given[1]}", given[2])).make("test")
    fault = Fault(("inverter",), begin_s=(1, 2))
    expected = make_scenario(
        "ieee33",
        weights=CostWeights(backlog=1),
        faults=(fault,),
        datacenters={"clock_law": PrefillDecodeDvfs()},
        split="test",
    )
    assert scenario_hash(found) == scenario_hash(expected)


def test_ones_own_from_a_file_and_a_module(here, capsys):
    for where in ("own.py:make", f"{here}/own.py:make", "own:make"):
        found = ScenarioSpec(where, ("background.load_sigma=0.1",)).make("validation")
        assert (found.name, found.horizon, found.background.load_sigma, found.split) == ("mine", 20, 0.1, "validation")
    assert ScenarioSpec("own.py:here").make("test").name == "here"
    # Once as a file, once as a module.
    assert capsys.readouterr().out.split().count("imported") == 2


def test_a_file_is_read_and_asked_once_and_again_where_it_has_changed(here, capsys):
    spec = ScenarioSpec("own.py:make")
    first = spec.make("test")
    assert spec.make("test") is first
    spec.make("train")
    assert capsys.readouterr().out == "imported\nmade\n"
    (here / "own.py").write_text(OWN.replace("horizon=20", "horizon=21"))
    assert spec.make("test").horizon == 21


@pytest.mark.slow
def test_another_process_makes_the_same(here):
    spec = ScenarioSpec("own.py:make", ("horizon=30",))
    code = (
        "import pickle, sys; from dcgrid_env import scenario_hash\n"
        f"print(scenario_hash(pickle.loads({pickle.dumps(spec)!r}).make('test')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=here)
    assert done.stdout.splitlines()[-1] == scenario_hash(spec.make("test"))


@pytest.mark.parametrize(
    ("where", "overrides", "message"),
    [
        ("ieee124", (), r"no scenario 'ieee124'; did you mean ieee123, .*; or give path/to/file\.py:function"),
        ("own.py", (), r"say which function of it makes the scenario, own\.py:make"),
        ("nowhere.py:make", (), r"scenario 'nowhere\.py:make': there is no file nowhere\.py"),
        ("own.py:nothing", (), r"has no 'nothing'; it has make, fails, other, asks"),
        ("own.py:number", (), r"scenario 'own\.py:number' is of type int; it must be a Scenario"),
        ("own.py:other", (), r"scenario 'own\.py:other' is of type int; it must be a Scenario"),
        ("own.py:fails", (), r"scenario 'own\.py:fails' fails, own\.py line 17: KeyError: 'k'"),
        ("own.py:asks", (), r"scenario 'own\.py:asks' fails: TypeError: asks\(\) missing 1 required"),
        ("toy6", ("horizn=3",), r"^set: no scenario field 'horizn'; did you mean horizon"),
        (
            "toy6",
            ("n_datacenters=99999999999999999999",),
            r"datacenters.count is 9+; give a whole number of at least 0",
        ),
        ("toy6", ("weights={backlg=1}",), r"weights.*backlg"),
        ("toy6", ("horizon=-1",), r"horizon is -1; give"),
        ("toy6", ("horizon=ten",), r"horizon is 'ten'; give"),
        ("toy6", ("feeder=none",), r"no feeder 'none'; "),
        ("toy6", ("split=test",), r"set: split is chosen by the command"),
        ("toy6", ("observe=feeder",), r"set: observe is chosen by an option of the command; leave one"),
    ],
)
def test_what_is_no_scenario_is_one_line(here, where, overrides, message):
    with pytest.raises(ValueError, match=message) as raised:
        ScenarioSpec(where, overrides).make("test", **({"observe": "local"} if "observe=feeder" in overrides else {}))
    assert len(str(raised.value).splitlines()) == 1


def test_a_field_of_a_part_is_set_by_its_path():
    changed = ScenarioSpec("ieee33", ("sensing.noise_pu=0.005", "sensing.delay_steps=1", "horizon=9")).make("test")
    expected = make_scenario("ieee33", sensing={"noise_pu": 0.005, "delay_steps": 1}, horizon=9, split="test")
    assert scenario_hash(changed) == scenario_hash(expected)
