"""Tuning: it finds the result of a plain search, is reproducible, and found the bundled parameters."""

import json
from dataclasses import replace
from importlib.resources import files
from typing import Any

import numpy as np
import pytest

from dcgrid_env import PRESETS, make_scenario
from dcgrid_env.baselines import CONTROLLERS, ConstantQ, Droop, NoControl, make_controller, rollout
from dcgrid_env.baselines.rollout import ControllerError
from dcgrid_env.baselines.tuning import search
from dcgrid_env.baselines.tuning.search import mean_cost, tune
from dcgrid_env.baselines.tuning.tunable import TUNABLE
from dcgrid_env.baselines.tuning.tuned import tuned_parameters
from helpers.needs import ships
from helpers.three_phase import ieee13, ieee123

EPISODES, EPISODES_OF_DAY = 20, 4
SHORTENED: dict[str, Any] = {"smoothing": {"horizon": 600, "weights": {"leftover": 900.0}}}
"""Presets whose long episodes are tuned on shortened ones, 8 of them, and what the droop had. Work that is left counts
more there, since it would wait on."""
SHIPPED = json.loads((files("dcgrid_env.baselines.data") / "tuned.json").read_text(encoding="utf-8"))


def test_mean_cost_is_the_records_mean():
    scenario = make_scenario("ieee33-weak", split="validation", horizon=20)
    recorder = rollout(scenario, Droop(), range(3))
    j = [metrics["J"] for metrics in recorder.metrics()]
    np.testing.assert_allclose(recorder.costs(), j)
    assert mean_cost(scenario, Droop(), 3) == pytest.approx(np.mean(j))


def test_costs_hold_where_the_power_flow_ends_an_episode():
    scenario = make_scenario("toy6", datacenters={"p_rated_kw": 20_000.0}, split="validation")
    recorder = rollout(scenario, NoControl(), range(2))
    assert recorder.metrics()[0]["power_flow_converged"] == 0.0
    np.testing.assert_allclose(recorder.costs(), [metrics["J"] for metrics in recorder.metrics()])


@pytest.mark.slow
def test_one_gain_against_a_plain_search():
    scenario = make_scenario("toy6", split="validation", horizon=15)
    found = tune("droop-q", [scenario], episodes=1)
    grid = [mean_cost(scenario, Droop(0.0, k_q), 1) for k_q in np.geomspace(0.01, 60.0, 60)]
    assert found.score <= min(grid) + 1e-3
    assert mean_cost(scenario, Droop(**found.parameters), 1) == pytest.approx(found.score)
    assert tune("droop-q", [scenario], episodes=1) == found


@pytest.mark.slow
def test_one_share_for_several_scenarios_and_one_for_each_agent_of_one():
    toy, weak = (make_scenario(name, split="validation", horizon=5) for name in ("toy6", "ieee33-weak"))
    together = tune("constant-q", [toy, weak], episodes=2)
    assert isinstance(together.parameters["q_share"], float)

    def share_of_none(q):
        return np.mean([mean_cost(s, ConstantQ(q), 2) / mean_cost(s, NoControl(), 2) for s in (toy, weak)])

    assert together.score == pytest.approx(share_of_none(together.parameters["q_share"]))
    assert together.score <= min(share_of_none(q) for q in np.linspace(-1, 1, 21)) + 0.01
    alone = tune("constant-q", [toy], episodes=2)
    assert len(alone.parameters["q_share"]) == 3
    assert alone.score <= mean_cost(toy, ConstantQ(together.parameters["q_share"]), 2)
    # Sites that are drawn anew are alike beforehand.
    drawn = tune("constant-q", [make_scenario("ieee123", split="validation", horizon=1)], episodes=1).parameters
    assert len(drawn["q_share"]) == 12
    assert len(set(drawn["q_share"][:5])) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("volt-var", ["toy6"], 2), "no tunable law 'volt-var'; there are droop, droop-q"),
        (("droop", [], 2), "0 scenarios and 2 episodes"),
        (("droop", ["toy6"], 0), "1 scenarios and 0 episodes"),
    ],
)
def test_what_cannot_be_tuned(arguments, message):
    name, scenarios, episodes = arguments
    with pytest.raises(ValueError, match=message):
        tune(name, [make_scenario(s) for s in scenarios], episodes)


def test_every_preset_ships_every_law():
    expected = {law: {name for name in PRESETS if ships(law, make_scenario(name))} for law in TUNABLE}
    assert {law: set(of_scenario) for law, of_scenario in SHIPPED["laws"].items()} == expected
    for law, of_scenario in SHIPPED["laws"].items():
        for name, record in of_scenario.items():
            if name in SHORTENED:
                assert record["command"].startswith(f"dcgrid tune --laws {law} --scenarios {name} --set horizon=")
                continue
            episodes = EPISODES_OF_DAY if name == "ieee123-3ph-day" else EPISODES
            options = f"--laws {law} --scenarios {name} --episodes {episodes}"
            assert record["command"] == f"dcgrid tune {options}"


@pytest.mark.parametrize(
    ("law", "preset"),
    [
        pytest.param(law, preset, marks=pytest.mark.slow if preset == "ride-through" and law != "droop" else ())
        for preset in ("toy6", "ieee33", "robust", "ride-through", "ieee33-weak-ups")
        for law in SHIPPED["laws"]
        if preset in SHIPPED["laws"][law]
    ],
)
def test_what_ships_scores_here_as_it_did_when_found(law, preset):
    scenario = make_scenario(preset, split="validation")
    shipped = SHIPPED["laws"][law][preset]
    assert mean_cost(scenario, make_controller(f"{law}-tuned", scenario), EPISODES) == pytest.approx(shipped["J"])


LONG = ("ieee123-3ph-day", "smoothing")
"""Presets of more than a thousand steps."""


@pytest.mark.parametrize("preset", [pytest.param(p, marks=pytest.mark.slow) if p in LONG else p for p in PRESETS])
def test_tuning_did_no_harm(preset):
    """On the episodes it was tuned on, a tuned law costs no more than with its default parameters."""
    scenario = make_scenario(preset, split="validation", **SHORTENED.get(preset, {}))
    untuned = mean_cost(scenario, CONTROLLERS["droop"][1](), 8 if preset in SHORTENED else EPISODES)
    assert SHIPPED["laws"]["droop"][preset]["J"] <= untuned


def test_a_scenario_without_tuned_parameters_says_how_to_find_them():
    own = make_scenario("toy6", name="mine")
    with pytest.raises(
        ValueError, match=r"no tuned parameters of 'droop' for scenario 'mine'.*dcgrid tune --laws droop"
    ):
        make_controller("droop-tuned", own)
    with pytest.raises(ValueError, match="'droop-tuned' depends on the scenario; say which"):
        make_controller("droop-tuned")
    with pytest.raises(ValueError, match="no controller 'pid-tuned'"):
        make_controller("pid-tuned", own)
    assert isinstance(tuned_parameters("constant-q", make_scenario("ieee33")).parameters["q_share"], tuple)


def test_agents_without_reactive_power_have_no_share_of_it():
    scenario = make_scenario("ieee33-weak-ups")
    assert len(TUNABLE["constant-q"].bounds([scenario])) == 7
    shares = TUNABLE["constant-q"].parameters(np.full(7, 0.5), [scenario])["q_share"]
    assert shares == (0.5,) * 7 + (0.0,) * 3


class Refusing(NoControl):
    def reset(self, env_info):
        raise ValueError("too weak a feeder")


def test_what_a_law_refuses_is_said_and_not_what_the_search_makes_of_it(monkeypatch):
    monkeypatch.setitem(TUNABLE, "droop-q", replace(TUNABLE["droop-q"], law=lambda **_: Refusing()))
    with pytest.raises(ControllerError, match=r"cannot drive toy6, test_search.py line \d+: too weak"):
        tune("droop-q", [make_scenario("toy6", split="validation")], 1)


def test_gains_are_searched_as_low_as_an_episode_is_long_and_as_high_as_a_step_is_short():
    plain, day = make_scenario("toy6"), make_scenario("toy6", dt_s=60.0, horizon=200)
    for scenarios in [(plain,), (plain.replace(dt_s=0.1),), (plain, plain.replace(horizon=120))]:
        assert TUNABLE["droop-q"].bounds(scenarios) == [(-2.0, 2.5)]
    (low, high), _ = TUNABLE["droop"].bounds([day])[1:]
    assert (10.0**low, 10.0**high) == pytest.approx((1e-4, 10.0**2.5 / 60.0))
    assert TUNABLE["droop-q"].bounds([plain, day]) == [(low, 2.5)]


def test_equipment_has_no_share_of_reactive_power_to_search_for():
    given = ieee13().replace(grid_control={"regulators": "agent", "capacitors": {"cap1": "agent"}})
    drawn = ieee123().replace(grid_control={"regulators": "agent"})
    for scenario, width in ((given, 6), (drawn, 8)):
        law = TUNABLE["constant-q"]
        bounds = law.bounds([scenario])
        assert len(bounds) == width
        shares = law.parameters(np.linspace(0.1, 0.9, width), [scenario])["q_share"]
        assert len(shares) == (12 if scenario is drawn else 6)
        assert (np.array(shares) != 0.0).all()


@pytest.mark.parametrize("law", ["set-points", "static", "two-timescale"])
@pytest.mark.slow
def test_set_points_are_searched_with_the_rest_of_the_law(law, monkeypatch):
    monkeypatch.setattr(search, "CANDIDATES", 12)
    monkeypatch.setattr(search, "ITERATIONS", 5)
    settings = {"grid_control.regulator_settings": {"timer": "integrating"}}
    controlled = make_scenario("ieee13-3ph-published", split="validation", horizon=40, **settings)
    agents = controlled.replace(grid_control={"regulators": "setpoint", "capacitors": {"cap2": "setpoint"}})
    for scenario in (controlled, agents):
        found = tune(law, [scenario], episodes=2)
        assert found.trials <= 60
        tuned = scenario.replace(**found.overrides)
        assert bool(found.overrides) is (scenario is controlled)
        assert mean_cost(tuned, TUNABLE[law].law(**found.parameters), 2) == pytest.approx(found.score)
        assert found.score < mean_cost(scenario, TUNABLE[law].law(), 2) - 0.5
        for name, offset_v in found.parameters["offset_v"].items():
            assert offset_v == round(offset_v, 1), name
        assert ("q_share" in found.parameters) is (law != "set-points")
    assert tune(law, [agents], episodes=2) == found


@pytest.mark.slow
def test_a_search_of_set_points_ends_once_all_candidates_are_alike(monkeypatch):
    monkeypatch.setattr(search, "_EXTRA_STD", 0.0)
    monkeypatch.setattr(search, "CANDIDATES", 8)
    monkeypatch.setattr(search, "ELITES", 2)
    settings = {"grid_control.regulator_settings": {"timer": "reset"}}
    short = make_scenario("ieee13-3ph-published", split="validation", horizon=5, **settings)
    assert tune("set-points", [short], episodes=1).trials < 8 * search.ITERATIONS


def test_set_points_belong_to_one_scenario_that_leaves_some_open():
    scenario = make_scenario("ieee13-3ph-published", **{"grid_control.regulator_settings": {"timer": "reset"}})
    with pytest.raises(ValueError, match="set points belong to one scenario, got ieee13-3ph-published, "):
        tune("static", [scenario, scenario], episodes=1)
    with pytest.raises(ValueError, match="scenario 'toy6' has no set points to choose"):
        tune("set-points", [make_scenario("toy6")], episodes=1)
