"""The best known cost: the search over actions finds it, its records are driven again, and it is called no bound."""

import json

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.agents.evaluate_command import Evaluate
from dcgrid_env.apps.benchmark.benchmark_tables import scenario_table
from dcgrid_env.apps.benchmark.summary import summarise
from dcgrid_env.baselines import make_controller, published, rollout
from dcgrid_env.baselines.hindsight_costs import BEST_KNOWN, read_hindsight
from dcgrid_env.baselines.recorded_actions import RecordedActions, recorded_actions, replayed
from dcgrid_env.baselines.score import IS_NO_BOUND
from docs.studies.best_known import blocks
from docs.studies.best_known.action_search import Known, best_known
from docs.studies.best_known.best_known_values import BestKnownValues

SHORT = ("horizon=40",)
RULE = "staggered-return-tuned"


@pytest.fixture
def quick(monkeypatch):
    """A search of a few copies."""
    monkeypatch.setattr(blocks, "COPIES", 4)
    monkeypatch.setattr(blocks, "AHEAD", 10)


def returning(**changes):
    return make_scenario("ride-through", split="test", horizon=40, **changes)


def smoothing():
    return make_scenario("smoothing", split="test", horizon=120)


def begun(scenario, seeds, name):
    return best_known(scenario, seeds, {name: make_controller(name, scenario)}, {}, 0)


@pytest.mark.slow
def test_an_episode_is_searched_alone_and_falls_below_where_it_began(quick):
    s = returning()
    name = "staggered-return"  # untuned, which leaves more to gain
    start, rule = begun(s, [3, 5], name), make_controller(name, s)
    together = best_known(s, [3, 5], {name: rule}, {}, 2)
    alone = best_known(s, [5], {name: rule}, {}, 2)[0]
    assert alone.J == together[1].J
    assert (alone.actions == together[1].actions).all()
    for found, before, cost in zip(together, start, rollout(s, rule, [3, 5]).costs(), strict=True):
        assert pytest.approx(cost, rel=1e-3) == before.J
        assert found.J < 0.97 * before.J
        assert (found.start, found.rounds) == (name, 2)
    driven = rollout(s, RecordedActions(np.stack([found.actions for found in together])), [3, 5]).costs()
    assert driven == pytest.approx([found.J for found in together], rel=1e-9)


@pytest.mark.slow
def test_descent_lowers_the_cost_of_smoothing():
    s = smoothing()
    (start,) = begun(s, [0], "smoothing-tuned")
    (found,) = best_known(s, [0], {}, {0: start}, 3)
    assert found.J < 0.99 * start.J
    assert rollout(s, RecordedActions(found.actions[None]), [0]).costs() == pytest.approx([found.J], rel=1e-9)


def test_the_search_begins_with_whoever_costs_less():
    s = returning()
    start = begun(s, [0, 1], RULE)
    known = {0: start[0]._replace(J=0.0, start="kept"), 1: start[1]._replace(J=99.0, start="kept")}
    found = best_known(s, [0, 1], {RULE: make_controller(RULE, s)}, known, 0)
    assert [one.start for one in found] == ["kept", RULE]


@pytest.mark.slow
def test_the_command_keeps_what_can_be_driven_again_and_goes_on_from_it(quick, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "results/hindsight"
    BestKnownValues(set=SHORT, episodes=2, workers=1, controllers=RULE, rounds=1).run()
    s = returning()
    known = published(s, folder)
    assert known is not None
    assert known.is_best_known
    assert replayed(s, [0, 1], folder).costs() == pytest.approx(known.J, rel=1e-9)
    BestKnownValues(set=SHORT, episodes=3, workers=1, controllers=RULE, rounds=1).run()
    content = read_hindsight(folder, s.name)
    assert content is not None
    assert content["kind"] == BEST_KNOWN
    assert [record["rounds"] for record in content["episodes"]] == [2, 2, 1]
    assert content["episodes"][0]["J"] <= known.J[0]
    end = "--set horizon=40 --split test --episodes 3 --controllers staggered-return-tuned --rounds 1"
    assert content["command"].endswith(end)
    capsys.readouterr()

    Evaluate("return-by-hand", scenario="ride-through", set=SHORT, episodes=3).run()
    assert IS_NO_BOUND in capsys.readouterr().out.replace("\n", " ").replace("  ", " ")
    for damaged in (b"no xz", (folder / "ride-through.actions.xz").read_bytes()[:-20]):
        (folder / "ride-through.actions.xz").write_bytes(damaged)
        with pytest.raises(
            ValueError, match=r"ride-through.actions.xz is not the file that its JSON file names; delete"
        ):
            recorded_actions(s, folder)
    content["episodes"][0].pop("start")
    (folder / "ride-through.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match="has no 'start' in its episode at place 0; delete it"):
        BestKnownValues(set=SHORT, episodes=3).run()


def test_tables_say_best_known_and_not_hindsight():
    values = published(make_scenario("toy6", split="test"))
    assert values is not None
    values = values.select(range(3))
    assert not values.is_best_known
    costs = {"none": values.J + 2.0, "droop-tuned": values.J + 1.0}
    own = {name: [{"J": j} | dict.fromkeys(FIGURES, 0.0) for j in of_name] for name, of_name in costs.items()}
    observes = dict.fromkeys(costs, "local")
    best = values._replace(bound=np.full(3, -np.inf), is_best_known=True)
    summary = summarise("toy6", 3, own, observes, {}, list(costs), best)
    notes = " ".join(scenario_table(summary).notes)
    assert notes.startswith(f"Best known: J {values.J.mean():.4f}, ")
    assert IS_NO_BOUND in notes
    assert "Hindsight" not in notes


FIGURES = (
    "voltage_deviation_mean_pu", "outside_bus_seconds_pct", "cost_violation", "delay_mean_s", "delay_p99_s",
    "unserved_kws", "q_effort_pct",
)  # fmt: skip


def test_what_cannot_be_searched():
    with pytest.raises(ValueError, match="have no channel 'return'"):
        best_known(make_scenario("toy6"), [0], {}, {}, 1)
    with pytest.raises(ValueError, match="controllers: give at least one, nothing is known of episode 4"):
        best_known(returning(), [4], {}, {0: Known(1.0, "x", 0, np.zeros((40, 14)))}, 1)
    with pytest.raises(ValueError, match="episodes is 0; give at least 1"):
        BestKnownValues(episodes=0).run()
    with pytest.raises(ValueError, match="rounds is -1; give at least 0"):
        BestKnownValues(rounds=-1).run()
