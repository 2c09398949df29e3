"""The replay of the best policy, and progress in the output, of every algorithm."""

import base64
import gzip
import json
import re

import pytest

from dcgrid_env import make_scenario
from dcgrid_env.agents import Policy
from dcgrid_env.agents.train_command import ALGORITHMS
from dcgrid_env.agents.training import best_replay
from dcgrid_env.agents.training.run_folder import read_curve
from dcgrid_env.baselines import rollout

COMMON = {"num_envs": 4, "hidden": (4,), "validation_episodes": 2, "validate_every": 1}
TOY = COMMON | {"scenario": "toy6", "set": ("horizon=8",)}
STEPS = {name: value for name, value in TOY.items() if name != "hidden"} | {"steps": 96, "validate_every": 32}
TINY = {
    "analytic": TOY | {"updates": 3, "window": 8},
    "safe": TOY | {"updates": 3, "window": 8},
    "cem": TOY | {"population": 4, "elites": 2, "iterations": 3},
    "affine": TOY | {"hidden": (), "population": 4, "elites": 2, "iterations": 3},
    "ppo": STEPS,
    "sac": STEPS,
    "td3": STEPS,
    "carry-over": COMMON | {"num_envs": 2, "updates": 2, "feeders": 1, "steps": 4, "validation_feeders": 1},
}


def data_of(page):
    """Data of a replay, as the page unpacks them."""
    (packed,) = re.findall(r'id="data"[^>]*>([^<]+)<', page.read_text(encoding="utf-8"))
    return json.loads(gzip.decompress(base64.b64decode(packed)))


def without_times(folder):
    rows = read_curve(folder)
    return [
        {k: v for k, v in row.items() if k not in ("seconds", "steps_per_s") and not k.endswith("_s")} for row in rows
    ]


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "carry-over")) for name in ALGORITHMS]
)
@pytest.mark.slow
def test_the_replay_changes_nothing_and_every_validation_has_a_line(name, tmp_path, capsys):
    """Curve and policy are the same with and without the replay, and the replay is of the best policy."""
    algorithm, folders = ALGORITHMS[name], {}
    for replay in (True, False):
        config = algorithm.configuration()(**TINY[name], replay=replay, out=tmp_path / str(replay))
        folders[replay] = algorithm.module().main(config)
    curve = without_times(folders[True])
    assert curve == without_times(folders[False])
    weights = {(folder / "policy.safetensors").read_bytes() for folder in folders.values()}
    assert len(weights) == 1
    assert not (folders[False] / "replay.html").exists()
    lines = [line for line in capsys.readouterr().out.splitlines() if " left" in line]
    assert len(lines) == 2 * len(curve)
    for line, row in zip(lines, curve * 2, strict=True):
        assert re.search(rf": \d+ % of \d iterations, J {row['J']:.4f}, (droop|law) \d.*, 0:\d\d:\d\d left$", line)
    assert ": 100 % of " in lines[-1]
    best, reference = data_of(folders[True] / "replay.html")["runs"]
    assert (best["name"], reference["name"]) == (name, "model-aided" if name == "carry-over" else "droop-tuned")
    if name != "carry-over":
        scenario = make_scenario("toy6", split="validation", horizon=8)
        series = rollout(scenario, Policy.load(folders[True] / "policy.safetensors"), [0]).series(0)
        packed = best["v"][-1]  # of the last node, as differences in units of the last decimal
        assert sum(packed["d"]) / 10 ** packed["k"] == pytest.approx(series.v_pu[-1, -1], abs=1e-4)


def test_a_replay_that_is_not_possible_is_reported_once(tmp_path, monkeypatch, capsys):
    scenario = make_scenario("toy6", split="validation", horizon=2)
    algorithm = ALGORITHMS["cem"]
    writer = best_replay.BestReplay(tmp_path, algorithm.configuration()(**TINY["cem"]))
    policy = Policy.load("toy6-analytic")
    writer.write(policy, scenario, "droop-tuned")
    assert [path.name for path in tmp_path.iterdir()] == ["replay.html"]
    monkeypatch.setattr("dcgrid_env.rendering.replay_page.MOST_VALUES", 1)
    for _ in range(2):
        writer.write(policy, scenario, "droop-tuned")
    assert capsys.readouterr().out.startswith("no replay.html: 2 x 2 steps at ")
    assert not list(tmp_path.iterdir())
