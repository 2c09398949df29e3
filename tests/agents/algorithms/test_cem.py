import dataclasses
import json

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.agents import Card, Policy
from dcgrid_env.agents.algorithms import cem as algorithm
from dcgrid_env.agents.algorithms.cem import Cem, main
from dcgrid_env.agents.training.run_folder import read_curve
from dcgrid_env.agents.training.validation import Validation
from dcgrid_env.baselines import rollout

TINY = Cem(
    scenario="toy6", set=("horizon=40",), num_envs=64, population=32, elites=6, iterations=24, hidden=(4,),
    validation_episodes=4, validate_every=8, checkpoint_every=4,
)  # fmt: skip


def without_times(folder):
    return [{name: value for name, value in row.items() if name != "seconds"} for row in read_curve(folder)]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    return main(dataclasses.replace(TINY, out=tmp_path_factory.mktemp("cem") / "run"))


@pytest.mark.slow
def test_the_search_improves_on_its_start(finished):
    """The start keeps the reactive power at zero; the policy is the best of the curve, on unseen episodes too."""
    curve = read_curve(finished)
    assert [row["step"] for row in curve] == [8, 16, 24]
    assert [row["env_steps"] for row in curve] == [8 * 64 * 40, 16 * 64 * 40, 24 * 64 * 40]
    policy, card = Policy.load(finished / "policy.safetensors"), Card.load(finished / "policy.json")
    validation = make_scenario("toy6", split="validation", horizon=40)
    best = min(row["J"] for row in curve)
    assert Validation([validation], 4)(policy)["J"] == pytest.approx(best, rel=1e-9)
    assert (card.algorithm, card.scenario, card.seed) == ("cem", "toy6 --set horizon=40", 0)
    assert card.validation_J == best
    test = make_scenario("toy6", split="test", horizon=40)
    start = algorithm.Search(TINY, algorithm.grid_of(TINY)).policy()
    own, idle = ([m["J"] for m in rollout(test, each, range(20)).metrics()] for each in (policy, start))
    assert np.mean(own) < 0.6 * np.mean(idle)


@pytest.mark.slow
def test_a_seed_gives_the_same_bytes_and_another_seed_others(finished, tmp_path):
    again = main(dataclasses.replace(TINY, out=tmp_path / "again"))
    assert without_times(again) == without_times(finished)
    assert (again / "policy.safetensors").read_bytes() == (finished / "policy.safetensors").read_bytes()
    other = main(dataclasses.replace(TINY, out=tmp_path / "other", seed=1))
    assert read_curve(other)[0]["J"] != read_curve(finished)[0]["J"]


@pytest.mark.slow
def test_a_killed_run_goes_on_with_the_same_curve(finished, tmp_path, monkeypatch):
    cfg, searched = dataclasses.replace(TINY, out=tmp_path / "run"), algorithm.Search.iterate

    def killed(search, iteration, run):
        if iteration == 14:
            raise KeyboardInterrupt
        return searched(search, iteration, run)

    with monkeypatch.context() as patch:
        patch.setattr(algorithm.Search, "iterate", killed)
        with pytest.raises(KeyboardInterrupt):
            main(cfg)
    assert [row["step"] for row in read_curve(cfg.folder)] == [8]
    main(dataclasses.replace(cfg, resume=True))
    assert without_times(cfg.folder) == without_times(finished)
    assert (cfg.folder / "policy.safetensors").read_bytes() == (finished / "policy.safetensors").read_bytes()


@pytest.mark.parametrize("view", ["shared", "centralised"])
@pytest.mark.parametrize("scenario", ["ieee123-3ph-day", "smoothing", "zero-shot"])
@pytest.mark.slow
def test_other_devices_views_and_feeders(scenario, view, tmp_path):
    """Regulators that are agents, further channels, and random feeders."""
    cfg = Cem(
        scenario=scenario, set=("horizon=6",), view=view, out=tmp_path / "run",
        num_envs=8, population=4, elites=2, iterations=2, validation_episodes=2,
    )  # fmt: skip
    policy = Policy.load(main(cfg) / "policy.safetensors")
    assert policy.kind == ("shared" if view == "shared" else "joint")
    assert Card.load(cfg.folder / "policy.json").inputs
    record = rollout(make_scenario(scenario, split="validation", horizon=6), policy, [0, 1]).metrics()
    assert np.mean([metrics["J"] for metrics in record]) == pytest.approx(read_curve(cfg.folder)[-1]["J"])
    assert json.loads((cfg.folder / "config.json").read_text())["population"] == 4


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"num_envs": 100}, r"^num_envs is 100; give a multiple of the population, 32$"),
        ({"population": 64, "num_envs": 32}, r"^num_envs is 32; give a multiple of the population, 64$"),
        ({"elites": 1}, r"^elites is 1; give at least 2 and at most the population, 32$"),
        ({"elites": 33}, r"^elites is 33; give at least 2 and at most the population, 32$"),
        ({"std": 0.0}, r"^std is 0.0; give more than 0 and at most 10$"),
        ({"device": "cuda"}, r"^device is 'cuda'; cem runs on the CPU alone: leave it out$"),
        ({"scenario": "nowhere"}, r"^no scenario 'nowhere'"),
    ],
)
def test_a_bad_setting_is_one_line_and_nothing_is_written(fields, said, tmp_path):
    with pytest.raises(ValueError, match=said):
        main(dataclasses.replace(TINY, out=tmp_path / "run", **fields))
    assert not (tmp_path / "run").exists()
