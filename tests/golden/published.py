"""Published figures, computed here: what ``golden.json`` contains and ``test_golden.py`` compares.

    python -m tests.golden.published

rewrites the file. Only a change that is meant to change a figure may do this, and must state it.
"""

from __future__ import annotations

import hashlib
import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import dcgrid_env
from dcgrid_env import PRESETS, Scenario, episode_hash, make_scenario, scenario_hash
from dcgrid_env.agents.policy.policy import SHIPPED, Policy
from dcgrid_env.baselines import Controller, make_controller, rollout
from docs.studies.publishing.agents import ALGORITHMS

GOLDEN = Path(__file__).with_name("golden.json")
EPISODES = 3
STEPS = 200
SPLITS = ("train", "validation", "test")


def of_preset(preset: str) -> dict[str, Any]:
    """All figures of a preset: hashes, costs of controllers, and what random actions lead to."""
    test = make_scenario(preset, split="test")
    shipped = files("dcgrid_env.baselines.data") / "hindsight" / f"{preset}.json"
    controllers: dict[str, Controller] = {"droop-tuned": make_controller("droop-tuned", test)}
    controllers |= {policy: Policy.load(policy) for policy in SHIPPED if policy in names_of(preset)}
    return {
        "hindsight_sha256": hashlib.sha256(shipped.read_bytes()).hexdigest(),
        "scenario_hash": {split: scenario_hash(make_scenario(preset, split=split)) for split in SPLITS},
        "episode_hash": [episode_hash(test, seed) for seed in range(EPISODES)],
        "J": {name: costs(test, controller) for name, controller in controllers.items()},
        "random_actions": random_actions(preset),
    }


def names_of(preset: str) -> list[str]:
    """Shipped policies that were trained on a preset, and on that of random feeders the one for any."""
    names = [f"{preset}-{algorithm}" for algorithm in ALGORITHMS]
    return [*names, "carry-over"] if preset == "zero-shot" else names


def costs(scenario: Scenario, controller: Controller) -> list[float]:
    """J of the test episodes of seeds 0, 1, .. under a controller."""
    return rollout(scenario, controller, range(EPISODES)).costs().tolist()


def random_actions(preset: str) -> dict[str, Any]:
    """Rewards, and a digest of observations and rewards, of steps under actions drawn evenly."""
    ids = {scenario: name for name, scenario in dcgrid_env.IDS.items()}
    env = gymnasium.make(ids[preset])
    shape = env.action_space.shape
    assert shape is not None
    rng, digest, rewards = np.random.default_rng(0), hashlib.sha256(), []
    observation, _ = env.reset(seed=0)
    digest.update(observation.tobytes())
    for _ in range(STEPS):
        action = rng.uniform(-1.0, 1.0, shape).astype(np.float32)
        observation, reward, terminated, truncated, _ = env.step(action)
        digest.update(observation.tobytes() + np.float64(reward).tobytes())
        rewards.append(float(reward))
        if terminated or truncated:
            observation, _ = env.reset()
            digest.update(observation.tobytes())
    env.close()
    return {"sha256": digest.hexdigest(), "rewards": rewards}


def main() -> None:
    """Write the file."""
    content = {preset: of_preset(preset) for preset in PRESETS}
    GOLDEN.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
