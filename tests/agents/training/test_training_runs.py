"""Runs that belong together: their commands, and that what is done is not done again."""

import json

import pytest

from dcgrid_env.agents import Card
from dcgrid_env.agents.algorithms.analytic import Analytic
from dcgrid_env.agents.algorithms.safe import Safe
from dcgrid_env.agents.algorithms.sb3 import Ppo
from dcgrid_env.agents.train_command import ALGORITHMS
from dcgrid_env.agents.training.training_runs import command, finished, train, train_all, words_of
from dcgrid_env.core.work.local_pool import ONE_PROCESS


def tiny(out, **others):
    return Analytic(scenario="toy6", updates=2, num_envs=4, validation_episodes=2, hidden=(4,), out=out, **others)


@pytest.mark.parametrize(
    "config",
    [
        Analytic(),
        Analytic(scenario="ieee33,das69", seed=3, delay_limit_s=0.25, vary=6, hidden=(32, 16)),
        Analytic(observe="feeder", preview=False, act="clock", learning_rate=1e-3),
        Safe(scenario="ieee33-weak", margin=0.4, updates=30),
        Analytic(scenario="mixed"),
        Analytic.for_scenario("mixed"),
        Ppo(scenario="ieee33-weak"),
        Ppo(scenario="scale-32", view="shared", outputs="droop", steps=1000),
    ],
)
def test_a_command_means_the_run(config, tmp_path):
    said = command(config).split()
    assert said[:3] == ["dcgrid", "train", type(config).__name__.lower()]
    assert ALGORITHMS[said[2]].configured(said[3:]) == config


def test_a_command_names_what_differs_only():
    assert command(Analytic(scenario="ieee123")) == "dcgrid train analytic --scenario ieee123"
    assert command(Analytic.for_scenario("mixed")) == "dcgrid train analytic --scenario mixed"
    assert command(Analytic(scenario="mixed")) == "dcgrid train analytic --scenario mixed --updates 200 --history 0"
    made = command(Analytic.for_scenario("toy6", preview=False, delay_limit_s=2.0))
    assert made == "dcgrid train analytic --scenario toy6 --no-preview --delay-limit-s 2"
    exact = Analytic.for_scenario("toy6", learning_rate=0.004130399570052626)
    assert float(words_of(exact)[-1]) == exact.learning_rate


@pytest.mark.slow
def test_a_run_is_done_once_and_others_are_told_apart(tmp_path):
    config = tiny(tmp_path / "run")
    assert not finished(config)
    assert list(train_all([config], ONE_PROCESS)) == [(config, None)]
    assert finished(config)
    assert not finished(tiny(tmp_path / "run", seed=1))
    assert "best on validation" in (tmp_path / "run" / "training.log").read_text()
    card = Card.load(tmp_path / "run" / "policy.json")
    assert (card.scenario, card.algorithm, card.seed) == ("toy6", "analytic", 0)
    before = (tmp_path / "run" / "policy.safetensors").read_bytes()
    # Without its mark it goes on from the checkpoint, where there is nothing left to do.
    (tmp_path / "run" / "finished.json").unlink()
    assert train(config) is None
    assert (tmp_path / "run" / "policy.safetensors").read_bytes() == before
    assert finished(config)


def test_a_folder_of_another_run_fails_and_says_why(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "config.json").write_text(json.dumps({"scenario": "ieee123"}))
    ((_, failure),) = train_all([tiny(tmp_path / "run")], ONE_PROCESS)
    assert failure is not None
    assert "scenario was 'ieee123' and is 'toy6' now" in failure
    assert not finished(tiny(tmp_path / "run"))
