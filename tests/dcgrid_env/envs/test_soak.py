"""3,000 steps of random actions across resets, on presets of every form."""

import resource

import gymnasium
import numpy as np
import pytest

from dcgrid_env import DcgridEnv

STEPS = 3_000


LONG = ("mixed", "fault", "ieee123-3ph", "ieee123-3ph-day", "ieee33-weak-ups", "ride-through", "smoothing", "routing")


@pytest.mark.slow
@pytest.mark.parametrize("scenario", LONG)
def test_random_actions(scenario):
    env = DcgridEnv(scenario)
    assert isinstance(env.observation_space, gymnasium.spaces.Box)
    low, high = env.observation_space.low, env.observation_space.high
    rng = np.random.default_rng(0)
    observation, _ = env.reset(seed=0)
    actions = rng.uniform(-1.0, 1.0, (1000, len(env.action_space.sample())))
    early = 0
    for step in range(STEPS):
        observation, reward, terminated, truncated, info = env.step(actions[step % 1000])
        assert ((observation >= low) & (observation <= high)).all()  # also False for a NaN
        assert -np.inf < reward <= 0.0
        if terminated or truncated:
            assert env.observation_space.contains(observation)
            assert all(np.isfinite(v) for v in info.values() if isinstance(v, np.floating))
            env.reset()
        if step == STEPS // 5:
            early = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    grown_mib = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - early) / 1024
    assert grown_mib < 8.0
