"""Scores and the figures next to them, on hand-made costs; their tables and plots."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.apps.benchmark import benchmark_figures, jobs
from dcgrid_env.apps.benchmark.benchmark_figures import (
    Replay,
    _apart,
    pareto_front,
    png,
    replay,
    scenario_figure,
    score_figure,
    short,
)
from dcgrid_env.apps.benchmark.benchmark_tables import COLUMNS, saved_table, scenario_table, score_table
from dcgrid_env.apps.benchmark.gather import Results
from dcgrid_env.apps.benchmark.jobs import V_EDGES_PU, Case
from dcgrid_env.apps.benchmark.report import _replayed
from dcgrid_env.apps.benchmark.summary import summarise
from dcgrid_env.baselines import NoControl, make_controller, rollout
from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.baselines.score import score
from dcgrid_env.core.text_table import Table
from dcgrid_env.rendering import run_figure

TOY6 = Case(ScenarioSpec("toy6"))
DROOP = [1.0, 1.2, 1.1, 0.9]
BEST = [0.5, 0.7, 0.6, 0.4]
OWN = [0.8, 0.9, 0.85, 0.7]


def episodes(costs, delay=0.0):
    beside = {metric.name: 0.5 for metric in COLUMNS} | {"delay_mean_s": delay}
    return [
        {"scenario": "toy6", "controller": "x", "episode": i, "seed": i, "J": j, **beside} for i, j in enumerate(costs)
    ]


def published(n=4, costs=BEST):
    return SimpleNamespace(
        seeds=np.arange(n), J=np.array(costs[:n]), bound=np.array(costs[:n]) - 0.1, is_best_known=False
    )


def made(found=None, doubt=None, failures=None, **records):
    known = records if records else {"droop-tuned": episodes(DROOP), "mine": episodes(OWN, 2.0)}
    known = {name.replace("_", "-"): value for name, value in known.items()}
    failures = failures or {}
    order = list(dict.fromkeys([*failures, *known]))
    n = len(next(iter(known.values())))
    return summarise("toy6", n, known, dict.fromkeys(known, "local"), failures, order, found, doubt)


def test_the_score_is_that_of_the_same_seeds():
    summary = made(published())
    assert summary.no_score is None
    reference, own = summary.rows
    assert reference.score == (0.0, 0.0, 0.0)
    expected = score(OWN, DROOP, BEST)
    assert own.score == expected.score
    assert own.difference == expected.difference
    # By hand: gains 0.2, 0.3, 0.25, 0.2 of 0.5 each; the middle half of J is 0.8 and 0.85.
    assert own.score is not None
    assert own.score.value == pytest.approx(0.95 / 2.0)
    assert own.interquartile_mean == pytest.approx(0.825)
    assert own.means is not None
    assert own.means["J"] == pytest.approx(0.8125)
    assert summary.hindsight == (pytest.approx(0.55), pytest.approx(0.45), pytest.approx(25.0))
    # By hand: mean costs 1.05, 0.8125 and 0.55.
    assert own.saved_pct == expected.saved_pct
    assert own.saved_pct is not None
    assert own.saved_pct.value == pytest.approx(100.0 * 0.2375 / 1.05)
    assert summary.headroom_pct == pytest.approx(100.0 * 0.5 / 1.05)
    table = scenario_table(summary)
    assert table.rows[1][table.header.index("J saved, %")].startswith("22.6 (")
    assert [row[1].split()[0] for row in saved_table([summary]).rows] == ["0.0", "22.6", "47.6"]
    program = "the linearised program's own optimum 0.4500 (largest gap of an episode 25.00 % of J)."
    note = f"Hindsight: J 0.5500, 47.6 % of J saved; {program}"
    assert note in scenario_table(summary).notes
    above = published()
    above.bound = above.J * [1.0, 1.02, 1.0, 1.0]  # the program may overestimate
    assert made(above).hindsight == (pytest.approx(0.55), pytest.approx(0.5535), pytest.approx(2.0))


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"found": None, "doubt": "hindsight is not known"}, "no score: hindsight is not known"),
        ({"found": published(4, [9.0] * 4)}, r"hindsight \(J 9.0000\) does not beat droop-tuned \(J 1.0500\)"),
        ({"found": published(), "doubt": "episode 0 has another hash"}, "no score: episode 0 has another hash"),
    ],
)
def test_without_hindsight_there_is_a_difference_and_a_reason(settings, reason):
    summary = made(**settings)
    assert re.search(reason, summary.no_score or "")
    own = summary.rows[1]
    assert own.score is None
    assert own.difference == score(OWN, DROOP, BEST).difference
    assert reason.replace("\\", "") in " ".join(scenario_table(summary).notes).replace("No score", "no score")
    assert score_table([summary]).rows[1] == ("mine", "–")


def test_without_the_reference_there_are_means_and_a_reason():
    summary = made(published(), failures={"droop-tuned": "failed: ValueError: oh"}, mine=episodes(OWN))
    assert summary.no_score == "no score: droop-tuned failed: ValueError: oh"
    assert summary.rows[1].difference is None
    assert summary.rows[1].interquartile_mean == pytest.approx(0.825)
    assert summary.rows[1].means is not None
    assert made(published(), mine=episodes(OWN)).no_score == "no score: droop-tuned was not run"
    both = made(None, "hindsight is not known", mine=episodes(OWN)).no_score
    assert both == "no score: droop-tuned was not run; hindsight is not known"


def test_one_episode_has_no_interval():
    summary = made(published(), droop_tuned=episodes(DROOP[:1]), mine=episodes(OWN[:1]))
    assert summary.no_score == "no score: an interval takes at least 2 episodes"
    assert summary.rows[1].means is not None


def test_a_failure_is_a_row_and_a_note():
    records = {"droop-tuned": episodes(DROOP), "mine": episodes(OWN)}
    summary = made(published(), failures={"mad": "failed: RuntimeError: no", "old": "does not apply: p_ref"}, **records)
    table = scenario_table(summary)
    assert [row[0] for row in table.rows] == ["mad", "droop-tuned", "mine"]
    assert table.rows[0][1] == "failed"
    assert {len(row) for row in table.rows} == {len(table.header)}
    assert "mad: failed: RuntimeError: no" in table.notes
    assert [note for note in table.notes if "do not apply to this scenario: old." in note]
    assert next(row.record() for row in summary.rows) == {
        "scenario": "toy6", "controller": "mad", "failure": "failed: RuntimeError: no",
    }  # fmt: skip


def test_only_controllers_that_apply_to_no_scenario_are_left_out_of_the_scores():
    both = {"old": "does not apply: p_ref", "new": "does not apply: storage", "mad": "failed: no"}
    records = {"droop-tuned": episodes(DROOP), "mine": episodes(OWN)}
    summaries = [made(published(), failures=both, **records)]
    del both["old"]
    summaries.append(replace(made(published(), failures=both, old=episodes(OWN), **records), scenario="ieee33"))
    scores, saved = score_table(summaries), saved_table(summaries)
    assert {row[0] for row in scores.rows} == {"old", "mad", "droop-tuned", "mine"}
    assert next(row for row in scores.rows if row[0] == "old")[1] == "does not apply"
    assert next(row for row in scores.rows if row[0] == "mad")[1:] == ("failed", "failed")
    assert [row[0] for row in saved.rows] == [*(row[0] for row in scores.rows), "hindsight (headroom)"]
    assert scores.notes[-1] == "Not in the table, because they do not apply to any of these scenarios: new."


def test_text_of_users_breaks_no_table():
    table = Table("a|b", ("c", "d"), (("x|y*<b>`[l](u)", "1.0 (0.5 to 1.5)"),), ("<script>",))
    lines = table.markdown().splitlines()
    assert Table("a", ("b", "c|d\n<e>"), ()).markdown().splitlines()[2] == "| b | c\\|d \\<e\\> |"
    assert lines[4] == "| x\\|y\\*\\<b\\>\\`\\[l\\](u) | 1.0 (0.5 to 1.5) |"
    page = table.html()
    assert "<b>" not in page
    assert "<script>" not in page
    assert "x|y*&lt;b&gt;" in page
    assert "<td>1.0<br><small>(0.5 to 1.5)</small></td>" in page


def test_the_worst_episode_is_that_of_the_best_beside_the_reference():
    summary = made(published())
    records = {"droop-tuned": episodes(DROOP), "mine": episodes(OWN)}
    sheet = Results(TOY6, summary, records, {}).sheet()
    assert sheet is not None
    assert sheet.worst == Replay(TOY6, {"mine": 1, "droop-tuned": 1})
    assert sheet.worst.seeds == (1,)
    alone = Results(TOY6, made(published(), droop_tuned=episodes(DROOP)), records, {}).sheet()
    assert alone is not None
    assert alone.worst == Replay(TOY6, {"droop-tuned": 1})
    other = records | {"mine": episodes([0.8, 0.9, 0.85, 0.95])}
    apart = Results(TOY6, made(published(), droop_tuned=other["droop-tuned"], mine=other["mine"]), other, {}).sheet()
    assert apart is not None
    assert apart.worst == Replay(TOY6, {"mine": 3, "droop-tuned": 1})
    assert apart.worst.seeds == (3, 1)


@pytest.mark.slow
def test_two_worst_episodes_are_replayed_under_both(monkeypatch):
    drawn = []

    def figure(scenario, runs, seed):
        drawn.append((seed, {name: series.metrics()["J"] for name, series in runs.items()}))
        return run_figure(scenario, runs, seed)

    monkeypatch.setattr(benchmark_figures, "run_figure", figure)
    worst = Replay(TOY6, {"none": 4, "droop": 2})
    pngs = replay(worst)
    assert len(pngs) == 2
    scenario = make_scenario("toy6", split="test")
    j = {name: [m["J"] for m in rollout(scenario, make_controller(name), [4, 2]).metrics()] for name in worst.costliest}
    assert drawn == [(seed, {name: j[name][i] for name in ("none", "droop")}) for i, seed in enumerate((4, 2))]
    page = "".join(_replayed("toy6", worst, pngs))
    headings = re.findall("The worst episode of (.*?), where J is highest", page)
    assert headings == ["none (seed 4", "droop (seed 2"]
    assert page.count("<img") == 2
    both = "".join(_replayed("toy6", Replay(TOY6, {"<i>": 4, "droop": 4}), (b"",)))
    assert "The worst episode of &lt;i&gt; and of droop (seed 4, where" in both


class Leaving(NoControl):
    def act(self, observations):
        raise SystemExit(3)


def test_a_replay_that_ends_the_program_is_a_line(monkeypatch):
    monkeypatch.setattr(jobs, "find_controller", lambda spec, scenario, tuned: Leaving())
    drawn = replay(Replay(TOY6, {"mine": 0}))
    assert re.fullmatch(
        r"mine failed when this was run again, in act, test_summary.py line \d+: SystemExit: 3", str(drawn)
    )
    assert _replayed("toy6", Replay(TOY6, {"mine": 0}), drawn) == [f"<p class=note>{drawn}</p>"]


def test_the_front_is_what_no_other_beats_in_both():
    x, y = np.array([0.0, 1.0, 2.0, 1.0, 0.0]), np.array([3.0, 2.0, 1.0, 2.5, 3.0])
    assert pareto_front(x, y).tolist() == [True, True, True, False, True]


@pytest.mark.parametrize("wanted", [[0.5] * 6, [0.0, 0.01, 0.9, 0.95, 1.0], [0.2], list(np.linspace(0, 1, 14))])
def test_names_keep_apart_in_order_and_inside(wanted):
    found = _apart(np.array(wanted), 0.06)
    assert (np.diff(found) >= 0.06 - 1e-12).all()
    assert found.min() >= 0.0
    assert found.max() <= 1.0
    assert len(found) == len(wanted)


@pytest.mark.slow
def test_figures_are_drawn_of_whatever_names_and_failures():
    name = "long/" * 20 + "$mine_{$.py:C"
    assert len(short(name)) <= 30
    records = {"droop-tuned": episodes(DROOP), name: episodes(OWN, 1.0)}
    summary = made(published(), failures={"mad": "failed"}, **records)
    counts = np.zeros(len(V_EDGES_PU) - 1)
    counts[150:250] = 1.0
    voltages = dict.fromkeys([row.controller for row in summary.working], counts)
    assert png(scenario_figure(summary, voltages, 0.05)).startswith(b"\x89PNG")
    scores = score_figure([summary, made()])
    assert scores is not None
    assert sum(ax.get_visible() for ax in scores.axes) == 1
    assert png(scores).startswith(b"\x89PNG")
    assert score_figure([made()]) is None
