"""SAC and TD3: what they have that PPO has not, a replay buffer and a squashed actor."""

import numpy as np
import pytest
import torch

from dcgrid_env import DcgridVectorEnv
from dcgrid_env.agents import Policy
from dcgrid_env.agents.algorithms import sac, td3
from dcgrid_env.agents.training import sb3
from dcgrid_env.agents.training.run_folder import read_curve

ALGORITHMS = {"sac": (sac, sac.Sac), "td3": (td3, td3.Td3)}
TINY = {"hidden": (8, 8), "validation_episodes": 2, "validate_every": 1, "checkpoint_every": 1, "num_envs": 6}


def tiny(name, tmp_path, folder="run", **fields):
    _, config = ALGORITHMS[name]
    given = {
        "scenario": "toy6",
        "out": tmp_path / folder,
        "steps": 1200,
        "batch": 16,
        "buffer": 1000,
        "gradient_steps": 1,
    }
    return config(**{**given, **TINY, **fields})


@pytest.mark.parametrize("view", ["shared", "centralised"])
@pytest.mark.parametrize("name", ALGORITHMS)
def test_the_exported_policy_acts_as_the_models_mean(tmp_path, name, view):
    cfg = tiny(name, tmp_path, scenario="ieee33-weak", view=view, num_envs=14)
    vec_env = sb3.vec_env_for(cfg)
    module, _ = ALGORITHMS[name]
    model = module.make(cfg, vec_env)
    torch.manual_seed(0)
    with torch.no_grad():
        for parameter in model.actor.parameters():
            parameter += 0.2 * torch.randn_like(parameter)
    policy = module.exported(cfg, vec_env, model)
    policy.reset(vec_env.scenario)
    native = DcgridVectorEnv(vec_env.n_envs, vec_env.scenario)
    vec_env.seed(3)
    observed, (joint, _) = vec_env.reset(), native.reset(seed=3)
    for _ in range(4):
        expected, _ = model.predict(observed, deterministic=True)
        observed, *_ = vec_env.step(expected)
        joint, *_ = native.step(policy.act(joint))
        for field in ("f_mhz", "q_kvar"):
            ours, theirs = (getattr(batch.transition.state, field) for batch in (native, vec_env.batch))
            np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-2)


@pytest.mark.parametrize("name", ALGORITHMS)
@pytest.mark.slow
def test_a_killed_run_goes_on_with_the_same_curve_bit_for_bit(tmp_path, monkeypatch, name):
    module, _ = ALGORITHMS[name]
    times = ("seconds", "physics_s", "learning_s", "validation_s", "steps_per_s")

    def curve(folder):
        return [{k: v for k, v in row.items() if k not in times} for row in read_curve(folder)]

    short = {"set": ("horizon=30",), "steps": 360}
    whole = module.main(tiny(name, tmp_path, "whole", **short))
    saved = sb3.Run.save

    def killed(run, state):
        saved(run, state)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(sb3.Run, "save", killed)
        with pytest.raises(KeyboardInterrupt):
            module.main(tiny(name, tmp_path, "broken", **short))
    broken = module.main(tiny(name, tmp_path, "broken", resume=True, **short))
    assert curve(broken) == curve(whole)
    assert len(curve(whole)) == 2
    assert Policy.load(broken / "policy.safetensors").sha256 == Policy.load(whole / "policy.safetensors").sha256


@pytest.mark.parametrize("name", ALGORITHMS)
@pytest.mark.slow
def test_a_horizon_is_no_end_in_the_replay_buffer(tmp_path, name):
    cfg = tiny(name, tmp_path)
    vec_env = sb3.vec_env_for(cfg)
    model = ALGORITHMS[name][0].make(cfg, vec_env)
    vec_env.seed(0)
    model.learn(600, log_interval=None)
    buffer = model.replay_buffer
    assert buffer.dones[99].all()
    assert buffer.timeouts[99].all()
    assert not buffer.dones[:99].any()
    assert np.array_equal(buffer.next_observations[:99], buffer.observations[1:100])
    assert not np.array_equal(buffer.next_observations[99], buffer.observations[0])


def test_noise_is_drawn_for_all_rows_at_once():
    np.random.seed(0)  # noqa: NPY002 (SB3 seeds this one)
    noise = td3.BatchedNoise(0.2, 5000, 2)()
    assert noise.shape == (5000, 2)
    assert noise.std() == pytest.approx(0.2, rel=0.05)
