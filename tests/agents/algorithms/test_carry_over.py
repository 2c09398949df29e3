"""Training on random feeders: begins as the law, learns alike each time; settings are checked, the family repeats."""

from typing import Any

import pytest

from dcgrid_env import scenario_hash
from dcgrid_env.agents import ModelAidedPolicy, Policy
from dcgrid_env.agents.algorithms import carry_over as algorithm
from dcgrid_env.agents.algorithms.carry_over import (
    CarryOver,
    CommissionedEnv,
    Corrections,
    drawn_on,
    drawn_scenario,
    main,
    moments,
)
from dcgrid_env.agents.training.run_folder import read_curve

TINY = {"updates": 2, "feeders": 1, "num_envs": 2, "steps": 3, "hidden": (4,), "validation_feeders": 1,
        "validation_episodes": 1, "validate_every": 1, "checkpoint_every": 1}  # fmt: skip


@pytest.mark.slow
def test_it_begins_as_the_law_and_learns_and_a_killed_run_goes_on_with_the_same_curve(tmp_path, monkeypatch):
    cfg = CarryOver(**TINY, out=tmp_path)
    env = CommissionedEnv(drawn_on(cfg, 0))
    networks: Any = Corrections(moments(cfg), cfg.hidden)
    assert env.episodes(networks, [0])[0] == env.episodes(None, [0])[0]
    main(cfg)
    first, second = read_curve(tmp_path)
    assert first["J"] != second["J"]
    assert [row["env_steps"] for row in (first, second)] == [6.0, 12.0]  # 1 feeder, 2 episodes of 3 steps each
    policy = Policy.load(tmp_path / "policy.safetensors")
    assert isinstance(policy, ModelAidedPolicy)
    assert policy.trained_on == "drawn-feeders"
    iterate = algorithm.Learner.iterate

    def killed(learner, iteration, run):
        if iteration == 2:
            raise KeyboardInterrupt
        return iterate(learner, iteration, run)

    with monkeypatch.context() as patch:
        patch.setattr(algorithm.Learner, "iterate", killed)
        with pytest.raises(KeyboardInterrupt):
            main(CarryOver(**TINY, out=tmp_path / "again"))
    main(CarryOver(**TINY, out=tmp_path / "again", resume=True))
    assert [row["J"] for row in read_curve(tmp_path / "again")] == [first["J"], second["J"]]


@pytest.mark.parametrize("given", [{"feeders": 0}, {"steps": 0}, {"scenario": "ieee33"}, {"device": "cuda"}])
def test_settings_that_cannot_be_are_refused(given, tmp_path):
    (field,) = given
    with pytest.raises(ValueError, match=field):
        main(CarryOver(**{**TINY, **given}, out=tmp_path))
    assert not list(tmp_path.iterdir())


def test_where_a_style_has_no_feeder_of_the_load_it_has_one_of_its_own():
    feeder, load_kw = algorithm._feeder(0.01, 1, 20, "us-mv")
    assert load_kw == pytest.approx(feeder.p_load_kw.sum())
    assert load_kw > 100.0


def test_a_number_is_always_the_same_scenario():
    hashes = {scenario_hash(drawn_scenario(split, i)) for split in ("train", "validation") for i in (0, 1)}
    assert len(hashes) == 4
    assert scenario_hash(drawn_scenario("train", 1)) in hashes
    assert drawn_scenario("validation", 0).split == "validation"
