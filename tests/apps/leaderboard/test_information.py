"""Information that a controller uses."""

import numpy as np
import pytest

from dcgrid_env import field_names
from dcgrid_env.agents import Network, Policy
from dcgrid_env.apps.leaderboard.entries import controller_of, scenario_of
from dcgrid_env.apps.leaderboard.information import measured_information, total_fields


@pytest.mark.parametrize(
    ("scenario", "controller", "information"),
    [
        ("toy6", "droop-tuned", "local"),
        ("toy6", "constant-q-tuned", "local"),
        ("toy6", "placement-tuned", "local + sensitivities"),
        ("toy6", "toy6-analytic", "local + sensitivities"),
        ("toy6", "guarded:toy6-analytic", "local + sensitivities"),
        ("toy6", "model-aided", "local + model"),
        ("toy6", "mpc", "joint + voltages + model"),
        ("ieee13-3ph", "mpc", "joint + voltages + regulators + model"),
        ("ieee123", "model-aided", "local + model"),
        ("routing", "droop", "local"),
        ("routing", "routing-analytic", "local + sensitivities + totals"),
        ("routing", "route-to-strongest", "joint + sensitivities"),
    ],
)
def test_the_information_of_a_controller_is_measured(scenario, controller, information):
    preset = scenario_of(scenario)
    assert measured_information(lambda: controller_of(controller, preset), preset, controller) == information


def test_one_network_of_all_agents_is_joint():
    rng = np.random.default_rng(0)
    joint = Policy({"joint": Network([(rng.normal(size=(23, 4)), np.zeros(4))])})
    assert measured_information(lambda: joint, scenario_of("toy6"), "joint") == "joint + sensitivities"


def test_sums_over_sites_are_fields_of_the_observation():
    routing = scenario_of("routing")
    assert total_fields(routing) & {name for names in field_names(routing).values() for name in names} == {
        "work_share", "work_next_all",
    }  # fmt: skip
