"""The command dcgrid dataset: Minari reads its files, they replay exactly, and an error is one line."""

import importlib
import json
import re
from types import SimpleNamespace

import minari
import numpy as np
import pytest

from dcgrid_env import make_scenario, scenario_hash
from dcgrid_env.agents import Card
from dcgrid_env.agents import dataset_command as dataset
from dcgrid_env.agents.policy.policy import FOLDER
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.cli.main import main
from helpers.places import ROOT

SHORT = ("--set", "horizon=4", "--episodes", "3")


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MINARI_DATASETS_PATH", raising=False)
    return tmp_path


def refused(capsys, *arguments):
    """The line with which a command is refused."""
    with pytest.raises(SystemExit) as ended:
        main(["dataset", *arguments])
    assert ended.value.code == 2
    return capsys.readouterr().err


def written(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


def test_a_data_set_is_read_by_minari_and_replays_bit_by_bit(here, monkeypatch, capsys):
    main(["dataset", "--controller", "droop", "--noise", "0.2", "--seed", "5", *SHORT])
    name = "dcgrid/ieee33-weak/droop-noise-0_2-v0"
    assert f"minari.load_dataset('{name}')" in capsys.readouterr().out
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(here / "results" / "datasets"))
    dataset = minari.load_dataset(name)
    assert (dataset.total_episodes, dataset.total_steps) == (3, 12)
    about = list(dataset.storage.get_episode_metadata(range(3)))
    assert [episode["seed"] for episode in about] == [5, 6, 7]
    assert about[0]["buses"]["dc_0"] == "18"
    env = dataset.recover_environment()
    for episode, kept in zip(dataset, about, strict=True):
        observation, _ = env.reset(seed=kept["seed"])
        np.testing.assert_array_equal(observation, episode.observations[0])
        info = {}
        for t, action in enumerate(episode.actions):
            observation, reward, *_, info = env.step(action)
            np.testing.assert_array_equal(observation, episode.observations[t + 1])
            assert reward == episode.rewards[t]
            assert info["cost_voltage"] == episode.infos["cost_voltage"][t + 1]
        assert info["J"] == kept["J"] == episode.infos["J"][-1]


def test_the_card_says_what_the_data_are(here):
    main(["dataset", "--controller", "none", "--split", "validation", *SHORT])
    folder = here / "results/datasets/dcgrid/ieee33-weak/none-validation-v0"
    card = json.loads((folder / "card.json").read_text())
    scenario = make_scenario("ieee33-weak", horizon=4, split="validation")
    costs = rollout(scenario, NoControl(), range(3)).costs()
    assert card["J"] == pytest.approx({"mean": costs.mean(), "least": costs.min(), "most": costs.max()})
    assert card["scenario_hash"] == scenario_hash(scenario)
    assert (card["split"], card["seeds"]) == ("validation", {"first": 0, "episodes": 3})
    assert (card["licence"], card["controller"], card["score"]) == ("MIT", "none", None)
    assert card["versions"]["dcgrid-env"]
    assert card["traces"][0]["name"] == "generator inference"


@pytest.mark.slow
def test_what_acts_has_its_score_from_its_card_or_by_definition(here):
    scored = Card.load(FOLDER / "ieee33-weak-ppo.json").scored
    assert scored is not None
    of_ppo = pytest.approx(scored.score[0], rel=1e-6)
    for controller, score in (("droop-tuned", 0.0), ("ieee33-weak-ppo", of_ppo), ("random", None)):
        main(["dataset", "--controller", controller, "--episodes", "1", "--out", "sets"])
        card = json.loads((here / f"sets/dcgrid/ieee33-weak/{controller}-v0/card.json").read_text())
        assert card["score"] == score
        assert card["score_why"]


@pytest.mark.slow
def test_several_controllers_take_turns_and_the_digest_is_that_of_the_content(here):
    words = ["dataset", "--set", "horizon=4", "--episodes", "5", "--noise", "0.1"]
    main([*words, "--controller", "droop,none,random"])
    main([*words, "--controller", "droop,none,random", "--name", "again"])
    main([*words, "--controller", "droop", "--name", "alone"])
    main([*words, "--controller", "random", "--noise", "0", "--name", "random"])
    folder = here / "results/datasets/dcgrid/ieee33-weak"
    sets = {path.name: minari.MinariDataset(path / "data") for path in folder.iterdir()}
    mixed, alone, random = (sets[f"{name}-v0"] for name in ("droop-and-none-and-random-noise-0_1", "alone", "random"))
    about = list(mixed.storage.get_episode_metadata(range(5)))
    assert [one["controller"] for one in about] == ["droop", "none", "random", "droop", "none"]
    for i, same in ((0, alone), (2, random), (3, alone)):  # random actions have no noise
        np.testing.assert_array_equal(mixed[i].actions, same[i].actions)
    digest = {name: json.loads((folder / name / "card.json").read_text())["sha256"] for name in sets}
    assert digest.pop("again-v0") == digest["droop-and-none-and-random-noise-0_1-v0"]
    assert len(set(digest.values())) == 3


@pytest.mark.slow
def test_the_data_sets_of_three_qualities_have_the_documented_costs(here):
    text = (ROOT / "docs" / "offline-data.md").read_text()
    documented = dict(re.findall(r"^\| `ieee33-weak` \| `(\w+)` \|.*\| ([0-9.]+) \|$", text, re.MULTILINE))
    commands = re.findall(r"dcgrid (dataset --controller .*--name (\w+))$", text, re.MULTILINE)
    assert sorted(documented) == sorted(name for _, name in commands) == ["expert", "mixed", "random"]
    for command, name in commands:
        main(command.split())
        card = json.loads((here / f"results/datasets/dcgrid/ieee33-weak/{name}-v0/card.json").read_text())
        assert card["J"]["mean"] == pytest.approx(float(documented[name]), abs=5.1e-4)


def test_hindsight_acts_as_it_planned(here, monkeypatch):
    plans = [np.full((4, 10), 0.25 * seed) for seed in range(3)]
    found = "dcgrid_env.agents.dataset_command.hindsight"
    monkeypatch.setattr(found, lambda scenario, seed: SimpleNamespace(actions=plans[seed]))
    main(["dataset", "--controller", "hindsight", "--workers", "1", *SHORT])
    dataset = minari.MinariDataset("results/datasets/dcgrid/ieee33-weak/hindsight-v0/data")
    np.testing.assert_array_equal([episode.actions for episode in dataset], np.array(plans, np.float32))


def test_what_cannot_be_is_one_line_and_writes_nothing(here, capsys, monkeypatch):
    assert "split: must be train or validation, got 'test'" in refused(capsys, "--split", "test")
    assert "noise: must be at most 2, got 3" in refused(capsys, "--noise", "3")
    assert "noise: must be 0 with random actions, got 0.1" in refused(
        capsys, "--controller", "random", "--noise", "0.1"
    )
    assert "episodes: must be at least the number of controllers, 2, got 1" in refused(
        capsys, "--controller", "droop,none", "--episodes", "1"
    )
    assert "controller: a name is empty in 'droop,'; remove the comma, or name a controller" in refused(
        capsys, "--controller", "droop,"
    )
    assert "episodes: must be at least 1, got 0" in refused(capsys, "--episodes", "0")
    assert "name is 'a b'" in refused(capsys, "--name", "a b")
    assert "observes 'feeder'" in refused(capsys, "--controller", "mpc", *SHORT)
    assert "no controller" in refused(capsys, "--controller", "nobody", *SHORT)
    real = importlib.import_module

    def without(name, *rest):
        if name == "h5py":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(importlib, "import_module", without)
    assert "written with h5py, which is not installed; in a clone" in refused(capsys, *SHORT)
    assert written(here) == []


def test_a_data_set_that_is_there_stays(here, capsys):
    main(["dataset", "--controller", "none", "--name", "mine", *SHORT])
    before = {path: path.read_bytes() for path in here.rglob("*") if path.is_file()}
    assert "mine-v0 is there already" in refused(capsys, "--controller", "droop", "--name", "mine", *SHORT)
    assert {path: path.read_bytes() for path in here.rglob("*") if path.is_file()} == before


def test_a_second_command_that_writes_the_same_data_set_is_one_line(here, capsys, monkeypatch):
    ours, words = dataset._episodes, ("--controller", "none", "--name", "mine", *SHORT)
    said = []

    def beside(*arguments):
        said.append(refused(capsys, *words))
        main(["dataset", "--controller", "none", "--name", "other", *SHORT])  # another of the same folder
        return ours(*arguments)

    monkeypatch.setattr(dataset, "_episodes", lambda *a: monkeypatch.setattr(dataset, "_episodes", ours) or beside(*a))
    main(["dataset", *words])
    (line,) = said[0].splitlines()
    assert "another data set (process " in line
    assert line.endswith("; give another --name, or wait until it has ended")
    folder = here / "results/datasets/dcgrid/ieee33-weak"
    assert sorted(path.name for path in folder.iterdir()) == ["mine-v0", "other-v0"]
    for name in ("mine-v0", "other-v0"):
        assert minari.MinariDataset(folder / name / "data").total_episodes == 3
