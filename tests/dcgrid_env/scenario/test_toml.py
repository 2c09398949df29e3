"""Scenario files: written, read again the same, and refused with file, field, value and remedy."""

import pickle
from typing import Any

import numpy as np
import pytest

from dcgrid_env import (
    PRESETS,
    Fault,
    PrefillDecodeDvfs,
    ScenarioError,
    episode_hash,
    load_feeder,
    make_scenario,
    scenario_hash,
)
from dcgrid_env.cli.main import main
from dcgrid_env.scenario import toml
from dcgrid_env.traces import PowerTrace

CHANGES = {
    "noise": {"sensing.noise_pu": 0.005, "sensing.delay_steps": 1},
    "devices": {
        "datacenters.buses": (7, 18, 25),
        "inverters.buses": (3,),
        "datacenters.p_rated_kw": (100.0, 200.0, 300.0),
    },
    "drawn": {"datacenters.buses": None},
    "law": {"datacenters.clock_law": PrefillDecodeDvfs(decode_clock_share=0.03)},
    "faults": {"faults": (Fault(("dc_0",), (1.0, 2.0)), Fault(("inverter",), (1.0, 2.0), (3.0, 4.0)))},
    "hour": {"background.start_hour": 6.5, "weights": {"loss": 1.0}},
    "pv": {"inverters.injection": "pv", "feeder": "ieee33", "horizon": 30},
}


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.slow
def test_a_preset_comes_back_the_same(preset, tmp_path):
    path = tmp_path / f"{preset}.toml"
    scenario = make_scenario(preset)
    scenario.to_toml(path)
    again = make_scenario(path)
    assert again.difference(scenario) is None
    assert scenario_hash(again) == scenario_hash(scenario)
    assert episode_hash(again, 3) == episode_hash(scenario, 3)


@pytest.mark.parametrize("name", CHANGES)
def test_what_differs_from_a_preset_comes_back_the_same(name, tmp_path):
    base = make_scenario("ieee33-weak")
    scenario = base.replace(name="mine", **CHANGES[name])
    text = scenario.to_toml(tmp_path / "a.toml", base=base)
    assert 'base = "ieee33-weak"' in text
    assert ("feeder" in text) == (scenario.feeder is not base.feeder)
    assert make_scenario(str(tmp_path / "a.toml")).difference(scenario) is None
    scenario.to_toml(tmp_path / "b.toml")
    assert make_scenario(tmp_path / "b.toml").difference(scenario) is None


def test_an_hour_taken_back_is_written_as_none(tmp_path):
    text = make_scenario("ieee33", background={"start_hour": 3.0}).replace(background={"start_hour": None}).to_toml()
    assert 'start_hour = "none"' in text


def test_paths_begin_where_the_file_stands(tmp_path):
    (tmp_path / "site.csv").write_text("time_s,site_w\n" + "".join(f"{t},{100 + t % 7}\n" for t in range(900)))
    feeder = tmp_path / "own"
    feeder.mkdir()
    (feeder / "feeder.toml").write_text('name = "own"\nbase_kv = 10.0\nsubstation = "s"\nv0_pu = 1.0\n')
    (feeder / "buses.csv").write_text("bus,p_kw,q_kvar\ns,0,0\na,10,3\nb,10,3\n")
    (feeder / "branches.csv").write_text("from_bus,to_bus,r_ohm,x_ohm\ns,a,0.1,0.1\na,b,0.1,0.1\n")
    path = tmp_path / "mine.toml"
    path.write_text(
        'feeder = "own"\nsource_voltage_pu = 1.0\nhorizon = 60\n[workload]\ntrace = "site.csv"\n'
        '[[devices]]\nkind = "datacenter"\ncount = 1\nbuses = ["a"]\np_rated_kw = 50.0\ns_rated_share = 1.1\n'
        'q_max_share = 0.3\n[[devices]]\nkind = "inverter"\nbuses = ["b"]\ns_rated_kva = 20.0\n'
    )
    scenario = make_scenario(path)
    assert (scenario.name, scenario.feeder.name, scenario.agents) == ("mine", "own", ("dc_0", "inv_0"))
    assert isinstance(scenario.workload.trace[0], PowerTrace)
    np.testing.assert_allclose(scenario.datacenters.parameters.p_rated_kw, [50.0])
    # Written elsewhere it names folder and file, as long as they hold what was read.
    (tmp_path / "far").mkdir()
    scenario.to_toml(tmp_path / "far" / "mine.toml")
    again = make_scenario(tmp_path / "far" / "mine.toml")
    assert scenario_hash(again) == scenario_hash(scenario)
    with pytest.raises(ScenarioError, match=r"feeder is a Feeder that is in no file.*feeder.to_csv\(folder\)"):
        pickle.loads(pickle.dumps(scenario)).to_toml()
    (feeder / "buses.csv").write_text("bus,p_kw,q_kvar\ns,0,0\na,11,3\nb,10,3\n")
    with pytest.raises(ScenarioError, match="feeder is a Feeder that is in no file"):
        scenario.to_toml()


def test_a_pickled_scenario_of_a_shipped_feeder_is_written_too():
    scenario = make_scenario("ieee33", horizon=30)
    again = pickle.loads(pickle.dumps(scenario))
    assert again.to_toml() == scenario.to_toml()
    assert "feeder" not in again.to_toml(base=make_scenario("ieee33"))


@pytest.mark.parametrize("base", ["ieee33", make_scenario("ieee33", horizon=7)])
def test_a_base_that_is_no_preset_as_it_is_is_refused(base):
    with pytest.raises(ScenarioError, match=r"base is .*'ieee33'; give a preset as make_scenario\(name\) gives it"):
        make_scenario("ieee33", horizon=7).to_toml(base=base)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("horizon = ", "Invalid value"),
        ("base = 3", "base is 3; give the name of a preset"),
        ('base = "ieee34"', "no scenario 'ieee34'; did you mean ieee33"),
        ('base = "ieee33"\nhorizont = 3', "no scenario field 'horizont'; did you mean horizon"),
        ('base = "ieee33"\n[sensing]\nnoise = 3', "sensing.noise is no field; did you mean noise_pu"),
        ('base = "ieee33"\n[sensing]\nnoise_pu = "high"', "sensing.noise_pu is 'high'; give a finite number"),
        ('base = "ieee33"\n[sensing]\nnoise_pu = -1.0', r"sensing.noise_pu is -1.0; give a finite number in \[0, 1\]"),
        ('base = "ieee33"\n[cost]\nreward = "mine"', "cost.reward is 'mine'; choose one of shared, local"),
        ('base = "ieee33"\n[cost.weights]\nvolts = 1', "cost.weights.volts is no field; did you mean voltage"),
        ('base = "ieee33"\nsensing = 3', r"sensing is 3; give Sensing\(...\) or a mapping of its fields"),
        ('base = "ieee33"\nobserve = "local"\n[sensing]\nobserve = "local"', "observe is given twice; give"),
        ('base = "ieee33"\n[[devices]]\nkind = "wind"', r"devices\[0\].kind is 'wind'; no kind of device 'wind'"),
        ('base = "ieee33"\n[[devices]]\nkind = "inverter"\nbuses = ["99"]\ns_rated_kva = 1', "has no bus '?99'?; its"),
        ('base = "ieee33"\n[[devices]]\nkind = "inverter"\nbuses = ["3"]', r"devices\[0\].s_rated_kva is 0.0; give"),
        ('base = "ieee33"\n[[devices]]\nkind = "datacenter"\ncount = 1', r"devices\[0\].p_rated_kw is missing"),
        ('base = "ieee33"\n[[faults]]\namong = ["dc_9"]\nbegin_s = [1, 2]', r"faults\[0\].among is 'dc_9'; choose"),
        ('base = "ieee33"\nfeeder = "nowhere"', "no feeder 'nowhere'"),
        ('feeder = "toy6"', "devices is missing; give it, a list of groups"),
        ("", "is empty: it has neither base nor feeder; give base, a preset's name"),
        ("horizon = 3", "has horizon, but neither base nor feeder; give base"),
        ('base = "ieee33"\nsensing = "none"', "sensing is None; leave it out, or give what"),
        ('base = "ieee33"\nfeeder = "."', "feeder.toml is missing"),
        ('base = "ieee33"\ntrace = "."', r"trace is '.*'; `dcgrid list traces` lists all; or give recordings"),
        ('base = "ieee33"\nfeeder = "a\\u0000b"', r"no feeder 'a\\x00b'; `dcgrid list feeders`"),
        ('base = "ieee33"\n[inverters]\nbuses = [["3"]]', r"inverters.buses has \('3',\), no number or text; give"),
        ('base = "ieee33"\nsource_voltage_pu = 9.0', r"source_voltage_pu is 9.0; give a finite number in \[0.5"),
        ('base = "ieee33"\nv0_pu = 9.0', "no scenario field 'v0_pu': it is source_voltage_pu now"),
        ('base = "toy6"\n[inverters]\nbuses = []\n[[faults]]\namong = ["ev"]\nbegin_s = [1, 2]', "choose data"),
    ],
)  # fmt: skip
def test_a_file_that_cannot_be_is_one_line_with_file_field_value_and_remedy(text, message, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(ScenarioError, match=message) as caught:
        make_scenario(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("own.toml", "own.toml is a folder; give a scenario"),
        ("a\0.toml", r"a\\x00.toml' is not a path.*; give the path"),
    ],
)
def test_a_path_that_is_no_file_is_one_line(name, said, tmp_path):
    (tmp_path / "own.toml").mkdir()
    with pytest.raises(ScenarioError, match=said):
        make_scenario(tmp_path / name)


def test_the_example_of_the_module_is_a_scenario(tmp_path):
    example = [line[4:] for line in (toml.__doc__ or "").splitlines() if line.startswith("    ")]
    (tmp_path / "mine.toml").write_text("\n".join(example))
    scenario = make_scenario(tmp_path / "mine.toml")
    assert (scenario.name, scenario.horizon, scenario.sensing.noise_pu) == ("mine", 60, 0.005)
    assert scenario.agents == ("dc_0", "dc_1")


def test_what_stands_in_no_file_is_refused():
    trace = PowerTrace([0.0, 500.0, 1000.0], [1.0, 0.5, 0.5], "own")
    with pytest.raises(ScenarioError, match=r"workload.trace\[0\] is a PowerTrace that is in no file.*give its path"):
        make_scenario("ieee33", trace=(trace,)).to_toml()


@pytest.mark.slow
def test_the_command_line_takes_a_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text('base = "toy6"\nhorizon = 5\n')
    line = ["run", "--scenario", "mine.toml", "--episodes", "1"]
    main([*line, "--controllers", "none"])
    assert "mine, " in capsys.readouterr().out
    (tmp_path / "mine.toml").write_text('base = "toy6"\nhorizon = -5\n')
    with pytest.raises(SystemExit) as stopped:
        main(line)
    assert stopped.value.code == 2
    (error,) = capsys.readouterr().err.splitlines()
    assert "mine.toml: scenario 'mine': horizon is -5; give a whole number of at least 1" in error


@pytest.mark.parametrize("preset", PRESETS)
def test_what_is_at_its_default_may_be_left_out(preset, tmp_path):
    scenario = make_scenario(preset)
    brief = scenario.to_toml(tmp_path / "a.toml", brief=True)
    assert scenario_hash(make_scenario(tmp_path / "a.toml")) == scenario_hash(scenario)
    assert "idle_share" not in brief
    assert len(brief) < 0.8 * len(scenario.to_toml())


@pytest.mark.parametrize("folder", ["my-feeder", "feeders/das69", "das69"])
def test_a_feeder_beneath_the_file_is_named_from_there(folder, tmp_path, monkeypatch):
    changed = load_feeder("ieee33").scaled(1.1, 1.0)
    changed.to_csv(tmp_path / "a" / folder)
    scenario = make_scenario("ieee33", name="mine", feeder=str(tmp_path / "a" / folder))
    (tmp_path / "a" / "deeper").mkdir()
    inside = scenario.to_toml(tmp_path / "a" / "mine.toml")
    assert str(tmp_path) not in inside
    beside = scenario.to_toml(tmp_path / "a" / "deeper" / "mine.toml")
    assert str(tmp_path / "a" / folder) in beside
    for where in ("mine.toml", "deeper/mine.toml"):
        assert scenario_hash(make_scenario(tmp_path / "a" / where)) == scenario_hash(scenario)
    (tmp_path / "a").rename(tmp_path / "moved")
    monkeypatch.chdir(tmp_path)
    assert scenario_hash(make_scenario("moved/mine.toml")) == scenario_hash(scenario)


@pytest.mark.parametrize(
    "key", ['trace = "site.csv"', '"workload.trace" = "site.csv"', '[workload]\ntrace = "site.csv"']
)
def test_a_recording_is_found_beside_the_file_however_it_is_named(key, tmp_path):
    (tmp_path / "site.csv").write_text("time_s,site_w\n" + "".join(f"{t},{100 + t % 7}\n" for t in range(900)))
    (tmp_path / "mine.toml").write_text(f'base = "ieee33"\nhorizon = 60\n{key}\n')
    trace: Any = make_scenario(tmp_path / "mine.toml").workload.trace
    assert trace[0].name == "site"
