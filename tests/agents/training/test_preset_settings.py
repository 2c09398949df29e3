"""Settings that ship, and that plain `dcgrid train` uses them."""

import dataclasses
import shlex

import pytest
import tyro

from dcgrid_env import PRESETS
from dcgrid_env.agents import Card, Policy
from dcgrid_env.agents.controllers import without_horizon
from dcgrid_env.agents.policy.policy import FOLDER, SHIPPED
from dcgrid_env.agents.train_command import ALGORITHMS, shipped_settings
from dcgrid_env.agents.training.config import all_settings, settings

RENAMED_OPTIONS = {"--lanes": "--num-envs"}
EVERY = [(algorithm, scenario) for algorithm, found in all_settings().items() for scenario in found]


def kind(algorithm):
    return ALGORITHMS[algorithm].configuration()


@pytest.mark.parametrize("name", SHIPPED)
def test_the_plain_command_of_a_card_means_all_that_the_policy_was_made_with(name):
    """The weights hold the command as it was given, most with every setting; the card's one line is the same run."""
    card, made_with = Card.load(FOLDER / f"{name}.json"), shlex.split(Policy.load(name).made_with)
    if card.scenario != without_horizon(card.scenario):  # on shorter episodes: the card's line has every option
        assert shlex.split(card.command) == made_with
        return
    assert card.command == f"dcgrid train {card.algorithm} --scenario {card.scenario} --seed {card.seed}"
    assert made_with[:3] == ["dcgrid", "train", card.algorithm]
    # What the settings were called when the weights were made stays in their files, byte for byte.
    made_with = [RENAMED_OPTIONS.get(word, word) for word in made_with]
    if card.algorithm == "ppo" and "--gamma" in made_with:  # by a PPO with settings of its own, until version 1.0
        return
    in_full = ALGORITHMS[card.algorithm].configured(made_with[3:])
    if len(made_with) > 7:  # every setting stands there, over the algorithm's own defaults
        assert in_full == tyro.cli(kind(card.algorithm), args=made_with[3:])
    assert ALGORITHMS[card.algorithm].configured(shlex.split(card.command)[3:]) == in_full
    assert kind(card.algorithm).for_scenario(card.scenario, seed=card.seed) == in_full


@pytest.mark.parametrize(("algorithm", "scenario"), EVERY)
def test_settings_are_fields_that_differ_from_the_defaults(algorithm, scenario):
    assert scenario in PRESETS
    plain, found = kind(algorithm)(), settings(algorithm, scenario)
    assert found
    for field, value in found.items():
        default = getattr(plain, field)
        assert default is None or type(value) is type(default)
        assert value != getattr(plain, field)


def test_options_stand_before_what_ships_and_the_line_names_the_rest():
    found = ALGORITHMS["analytic"].configured(
        ["--scenario", "ride-through", "--window", "40", "--seed", "5", "--validate-every", "2"]
    )
    assert (found.window, found.seed, found.validate_every, found.num_envs, found.updates) == (40, 5, 2, 64, 60)
    assert shipped_settings(found) == (
        "bundled settings for analytic on ride-through: updates 60, num_envs 64, learning_rate 0.005, "
        "trip_width_pu 0.01 (options override them)"
    )


@pytest.mark.parametrize(
    ("algorithm", "options"),
    [
        ("analytic", ["--scenario=mixed", "--view=centralised"]),
        ("ppo", ["--scenario=scale-32", "--view=shared"]),
        ("ppo", ["--scenario", "mine"]),
        ("analytic", ["--scenario", "mixed,das69"]),
        ("sac", ["--scenario", "ieee33-weak"]),
    ],
)
def test_elsewhere_are_the_algorithms_own_defaults_and_nothing_is_said(algorithm, options):
    found = ALGORITHMS[algorithm].configured(options)
    assert found == dataclasses.replace(kind(algorithm)(), scenario=found.scenario, view=found.view)
    assert shipped_settings(found) == ""


def test_help_shows_them(capsys):
    with pytest.raises(SystemExit):
        ALGORITHMS["ppo"].configured(["--help", "--scenario", "scale-32"])
    assert "(default: 20000)" in " ".join(capsys.readouterr().out.replace("│", " ").split())


def test_an_option_without_its_value_is_told(capsys):
    with pytest.raises(SystemExit) as ended:
        ALGORITHMS["ppo"].configured(["--scenario"])
    assert ended.value.code == 2
    assert "--scenario" in capsys.readouterr().err


def test_a_field_that_there_is_not_is_named():
    with pytest.raises(TypeError, match="'gama'"):
        kind("ppo").for_scenario("toy6", gama=0.5)
