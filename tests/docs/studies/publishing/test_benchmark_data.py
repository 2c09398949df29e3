"""Data files of the benchmark's pages: written from a run, and true of the code today."""

import json
import re

import pytest

from dcgrid_env import make_scenario, scenario_hash
from dcgrid_env.apps.benchmark.summary import BestKnownCost
from dcgrid_env.baselines import published
from dcgrid_env.cli.main import main
from docs.studies.commands import main as studies
from docs.studies.publishing.benchmark_data import REFERENCE, BenchmarkData, all_data, public_command


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder of a benchmark of a few episodes."""
    out = tmp_path_factory.mktemp("benchmark")
    controllers = "none,peak-shaving,mpc-one-step"
    main(["benchmark", "--scenarios", "toy6", "--controllers", controllers, "--episodes", "3", "--out", str(out),
          "--workers", "1"])  # fmt: skip
    return out


@pytest.mark.slow
def test_a_data_file_has_the_figures_of_the_run(run, tmp_path, capsys):
    out = tmp_path / "new.json"
    studies(["benchmark-data", str(run / "results.json"), "--out", str(out)])
    assert "3 rows, 1 scenario" in capsys.readouterr().out
    data, results = BenchmarkData.load(out), json.loads((run / "results.json").read_text())
    assert data.apply_to_none == ("peak-shaving",)
    assert data.command.endswith("--out results/new")
    assert str(run) not in data.command
    assert data.versions == results["meta"]["versions"]
    for row, summary in zip(data.rows, results["summaries"], strict=True):
        assert (row.controller, row.observes) == (summary["controller"], summary["observes"])
        assert row.score._asdict() == pytest.approx(summary["score"], rel=1e-5)
        assert row.saved_pct._asdict() == pytest.approx(summary["saved_pct"], rel=1e-5)
        assert row.means["J"] == pytest.approx(summary["means"]["J"], rel=1e-5)
    facts, best = data.scenarios["toy6"], published(make_scenario("toy6", split="test"))
    assert best is not None
    assert (facts.episodes, facts.hindsight.J) == (3, pytest.approx(best.J[:3].mean(), rel=1e-5))
    data.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == out.read_bytes()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda r: r["meta"]["scenarios"].update(toy6="0"),
            r"toy6: its hash is 0, now \w+; run dcgrid benchmark again",
        ),
        (lambda r: r["meta"].update(scenarios={"mine": "0"}), "scenario is 'mine'; publish presets only"),
        (lambda r: r["summaries"][0].update(score=None), "toy6, droop-tuned: score is null; publish runs with"),
        (lambda r: r["failures"][0].update(failure="failed: oh"), "toy6, peak-shaving: failed: oh; run dcgrid benchm"),
        (lambda r: r.pop("meta"), "meta, failures or summaries is missing; pass results.json of dcgrid benchmark"),
    ],
)
def test_a_run_that_cannot_be_published_is_one_line(change, said, run, tmp_path, capsys):
    results = json.loads((run / "results.json").read_text())
    change(results)
    path, out = tmp_path / "results.json", tmp_path / "data.json"
    path.write_text(json.dumps(results))
    with pytest.raises(SystemExit):
        studies(["benchmark-data", str(path), "--out", str(out)])
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert str(path) in error
    assert re.search(said, error)
    assert not out.exists()


def test_the_published_command_names_no_folder_of_the_machine():
    command = "dcgrid benchmark --controllers all --workers 1 --out '/tmp/a b' --scenarios toy6"
    assert public_command(command, "benchmark") == (
        "dcgrid benchmark --controllers all --scenarios toy6 --out results/benchmark"
    )


@pytest.mark.parametrize("page", sorted(all_data()))
def test_published_scores_follow_from_published_costs_and_hindsight(page):
    data = all_data()[page]
    for preset, facts in data.scenarios.items():
        scenario = make_scenario(preset, split="test")
        assert facts.scenario_hash in ("", scenario_hash(scenario))
        best = published(scenario)
        assert best is not None
        assert pytest.approx(best.select(range(facts.episodes)).J.mean(), abs=0.51e-4) == facts.hindsight.J
        assert isinstance(facts.hindsight, BestKnownCost) == best.is_best_known
        j_droop = data.of(preset)[REFERENCE].means["J"]
        headroom = j_droop - facts.hindsight.J
        for row in data.of(preset).values():
            value, low, high = row.score
            rounding = 0.0006 + 1e-4 * (1.0 + abs(value)) / headroom  # costs of some files have four decimals
            assert value == pytest.approx((j_droop - row.means["J"]) / headroom, abs=rounding)
            assert low <= value <= high
