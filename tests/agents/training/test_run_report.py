"""The report of a training."""

import json

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.agents import Card, Policy, evaluate
from dcgrid_env.baselines import make_controller
from dcgrid_env.baselines.hindsight_costs import published
from dcgrid_env.cli.main import main
from helpers.html_files import Balanced

TINY = ["--set", "horizon=10", "--updates", "2", "--num-envs", "2", "--hidden", "4", "--validation-episodes", "3"]


def read(path):
    return Balanced(path.read_text(encoding="utf-8"))


@pytest.mark.slow
def test_the_report_has_costs_with_intervals_curve_settings_and_versions(tmp_path, monkeypatch, capsys):
    """Of one seed without hindsight, then of two with it; every figure is compared with a separate evaluation."""
    monkeypatch.chdir(tmp_path)
    main(["train", "analytic", "--scenario", "toy6", *TINY, "--out", "a run"])
    assert "open a run/report.html" in capsys.readouterr().out
    page = read(tmp_path / "a run" / "report.html")
    text = " ".join(" ".join(page.text).split())
    assert page.links == ["replay.html"]
    assert not page.tags & {"script", "iframe", "link"}
    assert "No score: hindsight costs of these episodes are not stored" in text
    validation = make_scenario("toy6", split="validation", horizon=10)
    policy = Policy.load(tmp_path / "a run" / "policy.safetensors")
    own, droop = (evaluate(each, validation, range(3)) for each in (policy, make_controller("droop-tuned", validation)))
    assert f"seed 0 {own.means['J']:.4f} {100 * (1 - own.J.mean() / droop.J.mean()):.2f} (" in text
    assert f"droop-tuned {droop.means['J']:.4f} 0" in text
    assert "--updates 2 200" in text
    assert f"SHA-256 of the policy of seed 0 {policy.sha256}" in text
    card = Card.load(tmp_path / "a run" / "policy.json")
    assert card.command in text
    assert json.loads((tmp_path / "a run" / "config.json").read_text())["scenario_hashes"][0] in text

    main(["hindsight", "--scenarios", "toy6", "--set", "horizon=10", "--split", "validation", "--episodes", "3"])
    main(["train", "analytic", "--scenario", "toy6", *TINY, "--seeds", "2", "--workers", "1", "--out", "more"])
    assert "wrote more/report.html, the report over the seeds" in capsys.readouterr().out
    page = read(tmp_path / "more" / "report.html")
    assert page.links == ["seed-0/replay.html", "seed-1/replay.html"]
    assert read(tmp_path / "more" / "seed-1" / "report.html").links == ["replay.html"]
    text = " ".join(" ".join(page.text).split())
    costs, scores = published(validation, tmp_path / "results" / "hindsight"), []
    for seed in (0, 1):
        policy = Policy.load(tmp_path / "more" / f"seed-{seed}" / "policy.safetensors")
        scores.append(evaluate(policy, validation, range(3)).score(droop, costs).score)
        assert "{:.3f} ({:.3f} .. {:.3f})".format(*scores[-1]) in text
    assert f" {np.mean([score.value for score in scores]):.3f} (" in text
    assert "No score" not in text


@pytest.mark.slow
def test_carry_over_is_compared_with_the_law(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["--updates", "1", "--feeders", "1", "--num-envs", "2", "--steps", "4", "--validation-feeders", "1"]
    main(["train", "carry-over", *words, "--hidden", "4", "--validation-episodes", "1", "--no-replay", "--out", "run"])
    text = " ".join(" ".join(read(tmp_path / "run" / "report.html").text).split())
    assert "J of the law" in text
    assert "The trainings wrote no replay" in text
