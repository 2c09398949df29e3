"""Scenarios on which a difference reward is refused, and its settings."""

import pytest

from dcgrid_env import ScenarioError, make_scenario, scenario_hash


@pytest.mark.parametrize(
    ("name", "fields", "message"),
    [
        ("zero-shot", {"cost.reference": "profile"}, "has one target for all feeders: set cost.reference to 'nominal'"),
        ("smoothing", {}, "compares single steps, and smoothing of kind 'datacenter' acts on later ones"),
        (
            "ieee33-weak",
            {"weights": {"loss": 2.0}},
            "does not compare what weights.loss = 2 charges; set it to 0",
        ),
        ("ieee13-3ph", {"grid_control": {"regulators": "agent"}}, "give under_own_control"),
    ],
)
def test_what_it_does_not_cover_is_refused(name, fields, message):
    with pytest.raises(ScenarioError, match=message) as error:
        make_scenario(name, reward="difference", **fields)
    assert "\n" not in str(error.value)
    assert "use reward='shared' or 'local' there" in str(error.value)


@pytest.mark.parametrize(
    ("cost", "message"),
    [
        ({"default_action": "rest"}, "default_action is 'rest'; set reward to 'difference'"),
        ({"reward": "difference", "default_gains": (1, 2, 3)}, "set default_action to 'droop'"),
        (
            {"reward": "difference", "default_action": "droop", "default_gains": (1.0, -2.0)},
            "give 3 numbers >= 0",
        ),
        ({"reward": "difference", "default_action": "mean"}, "previous, rest, droop"),
    ],
)
def test_its_settings_are_checked(cost, message):
    with pytest.raises(ScenarioError, match=message):
        make_scenario("ieee33-weak", cost=cost)


def test_it_is_written_and_read_and_changes_the_hash_only_where_it_is_used(tmp_path):
    cost = {"default_action": "droop", "default_gains": [1.0, 20.0, 0.1]}
    scenario = make_scenario("ieee33-weak", reward="difference", cost=cost)
    scenario.to_toml(tmp_path / "scenario.toml")
    assert make_scenario(tmp_path / "scenario.toml").difference(scenario) is None
    plain = scenario.replace(cost={"reward": "shared", "default_action": "previous", "default_gains": (1.0, 0.5, 0.3)})
    assert scenario_hash(plain) == scenario_hash(make_scenario("ieee33-weak"))
    assert scenario_hash(scenario) != scenario_hash(plain)
