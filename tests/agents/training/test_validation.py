"""Validation of a policy during training."""

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.agents import Network, Policy
from dcgrid_env.agents.training.validation import Validation, made_with
from dcgrid_env.baselines import make_controller, rollout


def policy(clock=1.0):
    site, other = (np.zeros((9, 2)), [clock, 0.0]), (np.zeros((7, 1)), [0.0])
    return Policy({"datacenter": Network([site]), "inverter": Network([other])})


@pytest.mark.slow
def test_figures_are_means_over_episodes_and_scenarios_of_the_validation_split():
    found = Validation(["toy6", "ieee33-weak"], 3)(policy(-0.9))
    every, droop = [], []
    for name in ("toy6", "ieee33-weak"):
        scenario = make_scenario(name, split="validation")
        every += rollout(scenario, policy(-0.9), range(3)).metrics()
        droop += rollout(scenario, make_controller("droop-tuned", scenario), range(3)).metrics()
    assert len(every) == 6
    for name in ("J", "delay_mean_s"):
        assert found[name] == pytest.approx(np.mean([m[name] for m in every]))
    assert found["J_droop"] == pytest.approx(np.mean([m["J"] for m in droop]))
    assert found["gain"] == pytest.approx(1.0 - found["J"] / found["J_droop"])
    assert found["J_violation"] == pytest.approx(np.mean([m["cost_violation"] for m in every]))
    assert found["excess_mean_pu"] == pytest.approx(found["J_violation"] / 1000.0)
    waiting = np.mean([m["cost_backlog"] + m["cost_leftover"] for m in every])
    assert waiting > 0.1
    assert found["J_waiting"] == pytest.approx(waiting)


def test_a_policy_that_never_waits_pays_nothing_for_it():
    found = Validation(["toy6"], 2)(policy())
    assert found["delay_mean_s"] == 0.0
    assert found["J_waiting"] == 0.0


def test_the_command_is_what_was_typed_but_for_where_it_writes(monkeypatch):
    typed = ["train", "analytic", "--seed", "3", "--out", "/somewhere/else", "--resume"]
    monkeypatch.setattr("sys.argv", ["/somewhere/bin/dcgrid", *typed])
    assert made_with() == "dcgrid train analytic --seed 3"
