"""The search over an algorithm's settings: its spaces, that it goes on and is the same again, and what it prints."""

import dataclasses
import json
import tomllib

import pytest

from dcgrid_env.agents.algorithms import analytic
from dcgrid_env.agents.algorithms.analytic import Analytic
from dcgrid_env.agents.policy.card import Card
from dcgrid_env.agents.train_command import ALGORITHMS
from dcgrid_env.agents.training import run_folder
from dcgrid_env.agents.training.preset_settings import PATH
from dcgrid_env.agents.training.run_folder import Diverged, TrainingError
from dcgrid_env.agents.training.search_spaces import SPACES, Choice, within
from dcgrid_env.cli.main import main
from dcgrid_env.core.work.local_pool import LocalPool
from dcgrid_env.core.work.unit import Lost

pytest.importorskip("optuna")
from dcgrid_env.agents.training.agent_search import best_as_toml, ended, number_of, require_optuna, search
from dcgrid_env.agents.training.trial_training import TrialStatus, read_trial, train_trial


@pytest.mark.parametrize("algorithm", SPACES)
def test_defaults_and_what_ships_lie_within_the_spaces(algorithm):
    kind, shipped = ALGORITHMS[algorithm].configuration(), tomllib.loads(PATH.read_text()).get(algorithm, {})
    for name, space in SPACES[algorithm].items():
        assert name in {field.name for field in dataclasses.fields(kind)}
        assert within(space, getattr(kind(), name)), name
        for scenario, settings in shipped.items():
            assert within(space, settings.get(name, getattr(kind(), name))), (scenario, name)
        if not isinstance(space, Choice):
            assert 0.0 < space.low < space.high if space.log else space.low < space.high


@pytest.fixture
def trained(monkeypatch):
    """Trainings that are a formula: the cost of a validation falls to the distance from a rate of 0.02."""
    done = []

    def fake(cfg):
        done.append(cfg)
        cost = abs(cfg.learning_rate - 0.02)
        for step, left in enumerate((0.2, 0.1, 0.0)):
            for watcher in tuple(run_folder._watchers):
                watcher({"step": 10 * step, "J": 1.0 + cost * (1.0 + left)})
        Card("0", 1, "0" * 64, validation_J=1.0 + cost).save(cfg.out / "policy.json")
        return cfg.out

    monkeypatch.setattr(analytic, "main", fake)
    return done


def test_a_search_is_the_same_again_and_in_parts(tmp_path, trained):
    base = Analytic(scenario="toy6", max_grad_norm=2.0)
    whole = search(base, 8, 5, tmp_path / "whole", ("max_grad_norm",))
    for n in (3, 8):
        parts = search(base, n, 5, tmp_path / "parts", ("max_grad_norm",))
        assert len(ended(parts)) == n
    assert [trial.params for trial in parts.trials] == [trial.params for trial in whole.trials]
    assert len(trained) == 16
    assert all(cfg.max_grad_norm == 2.0 for cfg in trained)
    other = search(base, 3, 6, tmp_path / "other", ("max_grad_norm",))
    assert other.trials[0].params == whole.trials[0].params == {"learning_rate": 1e-2, "window": 40, "num_envs": 128}
    assert other.trials[1].params != whole.trials[1].params
    with pytest.raises(ValueError, match=r"journal.log: seed of the search was 5 and is 6 now"):
        search(base, 9, 6, tmp_path / "parts", ("max_grad_norm",))


def test_a_batch_is_the_same_wherever_and_in_which_order_its_trials_are_trained(tmp_path, trained):
    base = Analytic(scenario="toy6")
    whole = search(base, 8, 5, tmp_path / "whole", batch=3)
    assert [trial.number for trial in ended(whole)] == list(range(8))
    other = search(base, 8, 5, tmp_path / "other", batch=3, place=Backwards())
    assert [trial.number for trial in ended(other)] == [2, 1, 0, 5, 4, 3, 7, 6]
    for a, b in zip(ended(whole), ended(other), strict=True):
        for what in ("params", "value", "state", "intermediate_values"):
            assert getattr(a, what) == getattr(b, what)
        assert number_of(a) == number_of(b)
    assert len({tuple(trial.params.items()) for trial in ended(whole)}) == 8
    with pytest.raises(ValueError, match=r"journal.log: batch was 3 and is 1 now"):
        search(base, 9, 5, tmp_path / "whole")


def test_a_training_that_fails_is_named_and_the_others_are_kept(tmp_path, trained):
    base = Analytic(scenario="toy6")
    with pytest.raises(ValueError, match=r"1 of 3 trainings failed, the others are kept: trial 1: its machine is gone"):
        search(base, 3, 5, tmp_path / "run", batch=3, place=Without(key="trial-001"))
    again = search(base, 3, 5, tmp_path / "run", batch=3)
    assert [number_of(trial) for trial in ended(again)] == [0, 1, 2]
    assert [trial.number for trial in ended(again)] == [0, 2, 1]
    assert len(trained) == 3


def test_a_training_that_goes_on_counts_its_earlier_validations(tmp_path, trained):
    out = tmp_path / "trial-000"
    train_trial(Analytic(scenario="toy6", out=out), [])
    first = json.loads((out / "trial.json").read_text())
    assert list(first["costs"]) == ["0", "10", "20"]
    (out / "trial.json").write_text(json.dumps(first | {"costs": {"-10": 9.0, "0": 8.0, "10": 7.0}}))
    train_trial(Analytic(scenario="toy6", out=out), [])
    assert list(json.loads((out / "trial.json").read_text())["costs"]) == ["-10", "0", "10", "20"]


def test_what_a_folder_holds_is_read_or_named(tmp_path, trained, monkeypatch):
    base, out = Analytic(scenario="toy6"), tmp_path / "run" / "trial-000"
    search(base, 1, 0, tmp_path / "run")
    for damaged in ('{"costs', "{}", "[]", '{"costs": 1}'):
        (out / "trial.json").write_text(damaged)
        with pytest.raises(ValueError, match=r"trial.json: does not say how the trial went; delete the folder .*-000"):
            read_trial(out)
    assert read_trial(tmp_path) == TrialStatus()

    def refused(cfg):
        raise TrainingError("folder: holds another run")

    monkeypatch.setattr(analytic, "main", refused)
    with pytest.raises(ValueError, match=r"1 of 1 trainings failed, the others are kept: trial 1: .*holds another run"):
        search(base, 2, 0, tmp_path / "run")

    def diverged(cfg):
        cfg.out.mkdir(exist_ok=True)
        raise Diverged("not finite")

    monkeypatch.setattr(analytic, "main", diverged)
    assert ended(search(base, 2, 0, tmp_path / "run"))[1].state.name == "PRUNED"
    (tmp_path / "run" / "journal.log").write_text('{"bad\n{"bad\n')
    with pytest.raises(ValueError, match="holds no search that can be read"):
        search(base, 2, 0, tmp_path / "run")


def test_another_search_in_the_same_folder_is_refused(tmp_path, trained):
    base = Analytic(scenario="toy6")
    search(base, 1, 0, tmp_path / "run", ("num_envs",))
    with pytest.raises(ValueError, match=r"num_envs was 128 and is not said now"):
        search(base, 1, 0, tmp_path / "run")
    optuna = require_optuna()
    backend = optuna.storages.journal.JournalFileBackend(str(tmp_path / "run" / "journal.log"))
    study = optuna.load_study(study_name="analytic", storage=optuna.storages.JournalStorage(backend))
    study.add_trial(optuna.trial.create_trial(value=1.0))
    with pytest.raises(ValueError, match="is of an earlier version, which numbered trials otherwise; give another"):
        search(base, 1, 0, tmp_path / "run", ("num_envs",))


class Backwards(LocalPool):
    """Units one after the other, the last one first."""

    def run(self, units, shared=None):
        return super().run(units[::-1], shared)


@dataclasses.dataclass(frozen=True)
class Without(LocalPool):
    """A place on which one unit has no result."""

    key: str = ""

    def run(self, units, shared=None):
        for unit in units:
            if unit.key.endswith(self.key):
                yield unit, Lost("its machine is gone")
        yield from super().run([unit for unit in units if not unit.key.endswith(self.key)], shared)


def test_it_finds_what_is_better_and_stops_what_is_not(tmp_path, trained):
    study = search(Analytic(scenario="toy6"), 12, 0, tmp_path / "run")
    assert study.best_value < study.trials[0].value
    assert any(trial.state.name == "PRUNED" for trial in study.trials)
    own = tomllib.loads(best_as_toml(study, Analytic(scenario="toy6")))["analytic"]["toy6"]
    assert own["learning_rate"] == pytest.approx(study.best_params["learning_rate"], rel=0.01)
    assert set(own) <= set(SPACES["analytic"])


def test_an_interrupted_trial_is_done_again(tmp_path, trained, monkeypatch):
    base, whole = Analytic(scenario="toy6"), None
    whole = search(base, 3, 0, tmp_path / "whole")
    calls, fake = [], analytic.main

    def broken(cfg):
        calls.append(cfg)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return fake(cfg)

    monkeypatch.setattr(analytic, "main", broken)
    with pytest.raises(KeyboardInterrupt):
        search(base, 3, 0, tmp_path / "run")
    again = search(base, 3, 0, tmp_path / "run")
    assert [trial.params for trial in ended(again)] == [trial.params for trial in whole.trials]


def test_the_command(tmp_path, trained, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["tune-agent", "analytic", "--scenario", "toy6", "--trials", "3", "--fixed", "updates=7"]
    main(words)
    said = capsys.readouterr().out
    assert "0: J 1.0100, 0 s: learning_rate 0.01, window 40" in said
    assert "3 trials, 0 of them stopped early" in said
    assert "[analytic.toy6]\nupdates = 7" in said
    assert (tmp_path / "results/tune-agent/toy6-analytic/journal.log").exists()
    for asked, message in (
        (["tune-agent", "carry-over"], "algorithm: must have a search space, got 'carry-over'; choose from"),
        (["tune-agent", "dqn"], "no algorithm 'dqn'; choose from analytic, safe, cem"),
        (
            [*words[:-1], "colour=1"],
            "fixed: no analytic setting 'colour'; `dcgrid train analytic --help` lists all",
        ),
        ([*words[:-1], "updates"], "fixed: 'updates' is no field with its value"),
        (
            [*words[:-1], "updates=abc", "--out", "other"],
            "fixed: updates: invalid value 'abc'; input should be a valid integer",
        ),
        ([*words[:-1], "updates=0", "--out", "other"], "updates is 0; give more than 0"),
        (
            [*words[:-1], "hidden=[8, 8]", "act=all", "--out", "other"],
            "fixed: act: invalid value 'all'; input should be 'both'",
        ),
        ([*words, "--trials", "0"], "trials: must be at least 1, got 0\n"),
        ([*words, "--seed", "-1"], "dcgrid: seed: must be at least 0, got -1\n"),
    ):
        with pytest.raises(SystemExit):
            main(asked)
        said = capsys.readouterr().err
        assert message in said
        assert len(said.splitlines()) == 1
    assert not (tmp_path / "other").exists()
