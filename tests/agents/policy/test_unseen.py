"""A policy warns where it was not trained, and only there."""

import warnings

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.agents import Network, Policy, UnseenScenarioWarning
from dcgrid_env.agents.policy.input_range import recorded
from dcgrid_env.agents.policy.unseen import trained_scenarios, unseen


def policy(scenario):
    networks = {
        "datacenter": Network([(np.zeros((9, 2)), [1.0, 0.3])]),
        "inverter": Network([(np.zeros((7, 1)), [0.3])]),
    }
    return Policy(networks, scenario=scenario)


def test_one_warning_on_a_scenario_that_it_does_not_name():
    with pytest.warns(UnseenScenarioWarning, match="trained on toy6, ieee33 differs in feeder; .* guarded:") as said:
        policy("toy6").reset(make_scenario("ieee33"))
    assert len(said) == 1


@pytest.mark.parametrize(
    ("trained_on", "scenario"),
    [
        ("ieee33", make_scenario("ieee33", split="test", horizon=20, background={"load_sigma": 0.1})),
        ("ieee33", make_scenario("ieee33", name="mine")),
        ("toy6,ieee33", make_scenario("ieee33")),
        ("ieee33 --set datacenters.p_rated_kw=500", make_scenario("ieee33", datacenters={"p_rated_kw": 500.0})),
        ("zero-shot", make_scenario("zero-shot", split="test")),
        ("zero-shot", make_scenario("zero-shot", split="test").member(3)),
        ("ieee123-3ph-day", make_scenario("ieee123-3ph-day")),
        ("", make_scenario("ieee33")),
        ("own.py:make", make_scenario("ieee33")),
    ],
)
def test_no_warning_where_it_was_trained_or_nothing_is_known(trained_on, scenario):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert unseen(trained_on, scenario) is None


def test_a_file_of_the_same_scenario_is_known(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    make_scenario("ieee33", name="mine").to_toml(tmp_path / "mine.toml")
    assert unseen("mine.toml", make_scenario("ieee33")) is None
    assert unseen("ieee33", make_scenario("mine.toml")) is None
    assert unseen("mine.toml", make_scenario("das69")) == "feeder"
    assert unseen("ieee33 --set datacenters.p_rated_kw=500", make_scenario("ieee33")) == "datacenters.p_rated_kw"
    (tmp_path / "mine.toml").unlink()
    assert unseen("mine.toml", make_scenario("das69")) is None


def test_the_field_is_that_of_the_trained_scenario_on_the_same_feeder():
    other = make_scenario("das69", source_voltage_pu=1.03)
    assert unseen("das69,ieee33", other) == unseen("ieee33,das69", other) == "source_voltage_pu"
    assert unseen("ieee33", other) == "feeder"


def test_inputs_are_recorded_on_variants_of_what_a_policy_names_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = recorded(policy("toy6"), [make_scenario("toy6", source_voltage_pu=1.03, horizon=4)], episodes=1)
    assert found is not None
    assert set(found) == {"datacenter", "inverter"}


def test_code_of_the_users_own_is_not_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text("raise SystemExit\n")
    with pytest.raises(ValueError, match=r"trained on 'own.py:make', which is no scenario of a name"):
        trained_scenarios("own.py:make")
