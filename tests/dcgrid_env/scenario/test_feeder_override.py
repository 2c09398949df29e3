"""A feeder that is not bundled brings its source voltage into a scenario, in every way to name it."""

from dataclasses import replace
from pathlib import Path

import pytest

from dcgrid_env import Feeder, load_feeder, make_scenario
from dcgrid_env.apps.hosting.connection_study.study_command import make_job, read_request
from dcgrid_env.baselines.scenario_spec import ScenarioSpec


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("feeders") / "mine"
    feeder = load_feeder("ieee33")
    network = replace(feeder, name="mine").to_network()
    Feeder.from_network(replace(network, source=replace(network.source, v_pu=(1.03,)))).to_csv(made)
    return made


def made_from_toml(folder):
    path = folder.parent / "s.toml"
    path.write_text('base = "ieee33-weak"\nfeeder = "mine"\n', encoding="utf-8")
    return make_scenario(path)


WAYS = {
    "path": lambda folder: make_scenario("ieee33-weak", feeder=folder),
    "feeder": lambda folder: make_scenario("ieee33-weak", feeder=Feeder.from_csv(folder)),
    "command line": lambda folder: ScenarioSpec("ieee33-weak", (f"feeder={folder}",)).make("test"),
    "file": made_from_toml,
}


@pytest.mark.parametrize("way", WAYS)
def test_the_voltage_of_its_file_comes_along(folder, way):
    assert WAYS[way](folder).source_voltage_pu == 1.03


def test_a_voltage_that_is_set_too_wins_also_in_a_file_that_was_written(folder):
    base = make_scenario("ieee33-weak")
    scenario = make_scenario(base, feeder=folder, source_voltage_pu=base.source_voltage_pu)
    assert scenario.source_voltage_pu == 1.05
    path = folder.parent / "written.toml"
    scenario.to_toml(path, base=base)
    assert make_scenario(path).source_voltage_pu == 1.05
    assert make_scenario(scenario, feeder=folder).source_voltage_pu == 1.05  # the scenario's feeder already


def test_bundled_feeders_and_variants_keep_the_voltage_of_the_scenario():
    assert make_scenario("ieee33-weak", feeder="das69", **{"datacenters.buses": None}).source_voltage_pu == 1.05
    heavier = load_feeder("ieee33").scaled(1.1, 1.0)
    assert make_scenario("ieee33-weak", feeder=heavier).source_voltage_pu == 1.05


@pytest.mark.slow
def test_a_folder_with_the_name_of_a_bundled_feeder_is_read_from_files_in_the_present_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    network = load_feeder("ieee33").to_network()
    Feeder.from_network(replace(network, source=replace(network.source, v_pu=(1.03,)))).to_csv("ieee33")
    for text, v_pu in (("./ieee33", 1.03), ("ieee33", 1.0)):
        Path("s.toml").write_text(f'base = "ieee33-weak"\nfeeder = "{text}"\n', encoding="utf-8")
        assert make_scenario("s.toml").feeder.v0_pu == v_pu
        Path("study.toml").write_text(f'feeder = "{text}"\nbus = "12"\nmw = 0.1\n', encoding="utf-8")
        job = make_job(read_request(Path("study.toml")), Path("study.toml"))
        assert job.study.scenario.feeder.v0_pu == v_pu
