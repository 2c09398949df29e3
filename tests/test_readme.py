"""Claims of the README and the pages of docs/, reproduced."""

import re
import shlex
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import dcgrid_env
from dcgrid_env import make_scenario
from dcgrid_env.agents import find_controller
from dcgrid_env.baselines import make_controller, published, rollout
from dcgrid_env.baselines.score import score
from dcgrid_env.cli.main import main
from docs.studies.publishing import agents
from docs.studies.publishing.benchmark_data import all_data
from helpers.needs import has_policy
from helpers.places import ROOT

SCENARIOS, RESULTS, CONTROLLERS, TRAINING = (
    (ROOT / "docs" / f"{page}.md").read_text() for page in ("scenarios", "results", "controllers", "training")
)


def table(scenario):
    """The results of a scenario: controllers, and rows by their label."""
    lines = RESULTS[RESULTS.index(f"| `{scenario}` | none |") :].split("\n\n")[0].splitlines()
    cells = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]
    return cells[0][1:], {row[0]: [float(x) for x in row[1:]] for row in cells[2:]}


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["ieee123", "ieee33-weak"])
def test_results_are_those_of_the_command(scenario):
    controllers, rows = table(scenario)
    test = make_scenario(scenario, split="test")
    for i, name in enumerate(controllers):
        found = rollout(test, make_controller(name), range(100)).metrics()
        for label, key, decimals in (
            ("J", "J", 4),
            (r"mean \|V-1\|, p.u.", "voltage_deviation_mean_pu", 4),
            ("bus-seconds outside, %", "outside_bus_seconds_pct", 2),
            ("mean delay, s", "delay_mean_s", 2),
            ("unserved at the end, kW s", "unserved_kws", 1),
            ("mean loss, kW", "loss_mean_kw", 1),
        ):
            # Half a digit, and a little for the last bits of another processor's sums.
            assert np.mean([m[key] for m in found]) == pytest.approx(rows[label][i], abs=0.51 * 10.0**-decimals), label


SCORED = ("constant-q-tuned", "placement-tuned", "model-aided", "feedback", "mpc-one-step", "mpc")


def scores():
    """The score table: of each scenario J of no control, tuned droop and hindsight, the headroom, then scores."""
    lines = RESULTS[RESULTS.index("| scenario | J: none |") :].split("\n\n")[0].splitlines()[2:]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {row[0].strip("`"): [_score(cell) for cell in row[1:]] for row in rows}


def _score(cell):
    """A score or cost; NaN where a controller does not apply."""
    return float("nan") if cell in ("–", "does not apply") else float(cell.split()[0].rstrip(";"))


def test_scores_are_those_of_the_data_files():
    by_scenario = {scenario: data for data in all_data().values() for scenario in data.scenarios}
    assert set(scores()) == set(by_scenario) == set(dcgrid_env.PRESETS)
    for scenario, row in scores().items():
        data = by_scenario[scenario]
        found = data.of(scenario)
        costs = [found["none"].means["J"], found["droop-tuned"].means["J"], data.scenarios[scenario].hindsight.J]
        assert row[:3] == pytest.approx(costs, abs=0.51e-4)
        values = [found[name].score.value if name in found else float("nan") for name in SCORED]
        assert row[4:] == pytest.approx(values, abs=0.00501, nan_ok=True)


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["ieee33", "mixed", "training"])
def test_scores_come_out_again(scenario):
    test = make_scenario(scenario, split="test")
    values = published(test)
    assert values is not None
    j = {c: rollout(test, make_controller(c, test), range(100)).costs() for c in ("none", "droop-tuned", *SCORED[:2])}
    row = scores()[scenario]
    assert [j["none"].mean(), j["droop-tuned"].mean(), values.J.mean()] == pytest.approx(row[:3], abs=0.51e-4)
    found = [score(j[name], j["droop-tuned"], values.J).score.value for name in SCORED[:2]]
    assert row[4:6] == pytest.approx(found, abs=0.00501)


@pytest.mark.slow
def test_overrides_of_the_text_work_on_the_presets_they_are_for():
    rows = SCENARIOS[SCENARIOS.index("| change | fields |") :].split("\n\n")[0].splitlines()[2:]
    assert len(rows) == 9
    for overrides in (row.split("`")[1] for row in rows):
        name = "dcgrid/IEEE33Weak-v0" if "n_datacenters" not in overrides else "dcgrid/IEEE123-v0"
        names = {"gymnasium": gymnasium, "Fault": dcgrid_env.Fault}
        eval(f"gymnasium.make({name!r}, {overrides})", names).reset(seed=0)
    env = gymnasium.make("dcgrid/IEEE33-v0", n_datacenters=3, datacenters={"buses": None})
    assert env.get_wrapper_attr("scenario").datacenters.count == 3


def test_every_id_and_scenario_is_named():
    for name, scenario in dcgrid_env.IDS.items():
        assert f"| `{scenario}` | `{name.removeprefix('dcgrid/').rpartition('-v')[0]}` |" in SCENARIOS
        second = ("ThreePhase", "RideThrough", "WrongModel", "LateMeasurements")
        assert name.endswith("-v1" if any(word in name for word in second) else "-v0")


def test_agents_are_those_of_the_cards():
    made = agents.table()
    assert made.count("\n") == 1 + sum(map(has_policy, dcgrid_env.PRESETS))
    assert made in TRAINING


def test_the_controller_of_the_example_can_be_imported_without_running_anything(tmp_path, capsys):
    (block,) = (b for b in re.findall(r"```python\n(.*?)```", CONTROLLERS, re.DOTALL) if "class Leaning" in b)
    (tmp_path / "leaning.py").write_text(block)
    spec = f"{tmp_path}/leaning.py:Leaning(slope_kvar_per_pu=300)"
    law = find_controller(spec, make_scenario("ieee33-weak"))
    assert law.slope_kvar_per_pu == 300  # pyright: ignore[reportAttributeAccessIssue]
    assert capsys.readouterr().out == ""


@pytest.mark.slow
def test_the_scenario_of_the_example_runs_on_the_command_line(tmp_path, monkeypatch):
    (block,) = (b for b in re.findall(r"```python\n(.*?)```", SCENARIOS, re.DOTALL) if "def make()" in b)
    monkeypatch.chdir(tmp_path)
    Path("own.py").write_text(block)
    section = SCENARIOS[SCENARIOS.index("## Your own scenario") :].split("\n## ")[0]
    (commands,) = re.findall(r"```bash\n(.*?)```", section, re.DOTALL)
    run, *others = (shlex.split(line.partition("   #")[0]) for line in commands.splitlines())
    main([*run[1:], "--episodes", "1"])
    assert Path("results/run/results.json").is_file()
    for words in others:
        assert words[:1] == [".venv/bin/dcgrid"]
        assert words[1] in ("tune", "hindsight", "evaluate", "benchmark", "train")
        assert "own.py:make" in words
