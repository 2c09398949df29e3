"""The best that is known: it is found, driven again from its record, and called no bound anywhere."""

import json

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.agents import find_controller
from dcgrid_env.baselines import ReturnByHand, make_controller, published, rollout
from dcgrid_env.baselines.benchmark.benchmark_tables import IS_NO_BOUND, scenario_table
from dcgrid_env.baselines.benchmark.summary import summarise
from dcgrid_env.baselines.hindsight_costs import BEST_KNOWN, read_hindsight, records
from dcgrid_env.baselines.tuning import best_known as search
from dcgrid_env.baselines.tuning.best_known import SEARCH, Searched, best_known, replayed
from dcgrid_env.cli.best_known_values import BestKnownValues
from dcgrid_env.cli.evaluate import Evaluate

SHORT = ("horizon=40",)


@pytest.fixture
def quick(monkeypatch):
    """A search of a few lanes."""
    monkeypatch.setattr(search, "GENERATIONS", 3)
    monkeypatch.setattr(search, "CANDIDATES", 8)


def scenario(**changes):
    return make_scenario("ride-through", split="test", horizon=40, **changes)


def test_an_episode_is_searched_by_itself_and_no_worse_than_the_rule_it_began_with(quick):
    s = scenario()
    together, alone = best_known(s, [3, 5], {}), best_known(s, [5], {})
    assert together[1] == alone[0]
    rule = rollout(s, make_controller("staggered-return-tuned", s), [3, 5]).costs()
    assert [best.by for best in together] == [SEARCH, SEARCH]
    # The rule's times of sites that are locked out and not are one in the search.
    assert (np.array([best.J for best in together]) < rule + 0.01).all()


def test_whoever_costs_less_is_named_and_what_was_searched_is_not_searched_again(monkeypatch):
    monkeypatch.setattr(search, "_search", lambda *_: pytest.fail("searched again"))
    s = scenario()
    j = rollout(s, ReturnByHand(), [0, 1]).costs()
    kept = {0: Searched(j[0] - 1.0, (0.0,)), 1: Searched(j[1] + 1.0, (0.0,))}
    found = best_known(s, [0, 1], {"by hand": ReturnByHand()}, kept)
    assert [best.by for best in found] == [SEARCH, "by hand"]
    assert [best.J for best in found] == [j[0] - 1.0, j[1]]


def test_the_command_keeps_what_can_be_driven_again_and_calls_it_no_bound(quick, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = BestKnownValues(set=SHORT, episodes=3, workers=1, controllers="none")
    command.run()
    s = scenario()
    content = read_hindsight(tmp_path / "results/hindsight", s.name)
    assert content is not None
    assert content["kind"] == BEST_KNOWN
    assert content["command"].endswith("--set horizon=40 --split test --episodes 3 --controllers none")
    known = published(s, tmp_path / "results/hindsight")
    assert known is not None
    assert known.is_best_known
    for seeds, recorder in replayed(s, records(s, tmp_path / "results/hindsight"), find_controller):
        assert recorder.costs() == pytest.approx(known.of(seeds).J, rel=1e-9)
    monkeypatch.setattr(search, "_search", lambda *_: pytest.fail("searched again"))
    command.run()
    capsys.readouterr()

    Evaluate("return-by-hand", scenario="ride-through", set=SHORT, episodes=3).run()
    assert IS_NO_BOUND in capsys.readouterr().out.replace("\n", " ").replace("  ", " ")
    content["episodes"][0].pop("x")
    (tmp_path / "results/hindsight/ride-through.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match="has no 'x' in its episode at place 0; delete it"):
        command.run()


def test_tables_say_best_known_and_not_hindsight():
    values = published(make_scenario("toy6", split="test"))
    assert values is not None
    values = values.of(range(3))
    assert not values.is_best_known
    costs = {"none": values.J + 2.0, "droop-tuned": values.J + 1.0}
    own = {name: [{"J": j} | dict.fromkeys(FIGURES, 0.0) for j in of_name] for name, of_name in costs.items()}
    observes = dict.fromkeys(costs, "local")
    best = values._replace(bound=np.full(3, -np.inf))
    summary = summarise("toy6", 3, own, observes, {}, list(costs), best)
    notes = " ".join(scenario_table(summary).notes)
    assert notes.startswith(f"Best known: J {values.J.mean():.4f}. {IS_NO_BOUND}")
    assert "Hindsight" not in notes


FIGURES = (
    "voltage_deviation_mean_pu", "outside_bus_seconds_pct", "cost_violation", "delay_mean_s", "delay_p99_s",
    "unserved_kws", "q_effort_pct",
)  # fmt: skip


def test_what_cannot_be_searched():
    with pytest.raises(ValueError, match="have no channel 'return'"):
        best_known(make_scenario("toy6"), [0], {})
    with pytest.raises(ValueError, match="episodes is 0; give at least 1"):
        BestKnownValues(episodes=0).run()
