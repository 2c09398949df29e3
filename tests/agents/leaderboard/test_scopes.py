"""Scopes of entries: the data that is sent, and the data that a bundled controller uses."""

import numpy as np
import pytest

from dcgrid_env import field_names
from dcgrid_env.agents import Network, Policy
from dcgrid_env.agents.leaderboard.confinement import version
from dcgrid_env.agents.leaderboard.entry_files import SubmissionError
from dcgrid_env.agents.leaderboard.remote import remote
from dcgrid_env.agents.leaderboard.running import TUNED, controller_of, scenario_of
from dcgrid_env.agents.leaderboard.scopes import Scope, measured_scope
from dcgrid_env.baselines import Droop
from dcgrid_env.baselines.evaluation import evaluate


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "scope is ''"),
        ("sensitivities", "give local or joint"),
        ("local + joint", "give local or joint"),
        ("joint + neighbours + voltages", "not both"),
        ("local + all", "scope is 'local \\+ all'"),
    ],
)
def test_what_is_no_scope_is_refused(text, said):
    with pytest.raises(SubmissionError, match=said):
        Scope.parse(text)


def test_a_scope_has_one_spelling():
    assert str(Scope.parse("model+ sensitivities +joint")) == "joint + sensitivities + model"
    assert Scope.parse("joint + voltages").observe == "feeder"
    assert Scope.parse("local + neighbours").observe == "neighbours"


@pytest.mark.parametrize(
    ("scenario", "controller", "scope"),
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
def test_the_scope_of_a_controller_of_the_package_is_measured(scenario, controller, scope):
    preset = scenario_of(scenario)
    assert str(measured_scope(lambda: controller_of(controller, preset), preset, controller)) == scope


def test_one_network_of_all_agents_is_joint():
    rng = np.random.default_rng(0)
    joint = Policy({"joint": Network([(rng.normal(size=(23, 4)), np.zeros(4))])})
    scope = measured_scope(lambda: joint, scenario_of("toy6"), "joint")
    assert str(scope) == "joint + sensitivities"


def test_totals_over_sites_are_no_local_measurement():
    routing = scenario_of("routing")
    names = [name for own in field_names(routing).values() for name in own]
    local, more = (Scope.parse(text).columns(routing, routing.agents) for text in ("local", "local + totals"))
    assert {names[i] for i in set(more) - set(local)} == {"work_share", "work_next_all"}
    assert {"r", "x"}.isdisjoint(names[i] for i in local)


@pytest.mark.parametrize(
    ("scenario", "controller"),
    [("ieee33", "mpc"), ("ieee13-3ph", "mpc"), ("ieee123", "model-aided"), ("zero-shot", "mpc")],
)
def test_a_controller_acts_in_a_process_as_it_does_here(scenario, controller):
    preset = scenario_of(scenario).replace(horizon=10)
    scope = measured_scope(lambda: controller_of(controller, preset), preset, controller)
    here = evaluate(controller_of(controller, preset), preset, range(3))
    with remote(controller, preset, TUNED, scope) as other:
        there = evaluate(other, preset, range(3))
    assert there.J.tolist() == here.J.tolist()


@pytest.mark.slow
def test_a_local_law_acts_in_a_process_for_each_agent_as_in_one():
    preset, code = scenario_of("toy6").replace(horizon=20), b"from dcgrid_env.baselines import Droop"
    own = remote("controller.py:Droop", preset, TUNED, Scope.parse("local"), code, confined=bool(version()))
    with own as controller:
        apart = evaluate(controller, preset, range(3))
    assert apart.J.tolist() == evaluate(Droop(), preset, range(3)).J.tolist()
