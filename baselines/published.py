"""Hindsight's costs of the test episodes that ship with the package, so that a score costs no hour.

They stand in ``data/hindsight/<preset>.json`` with the hashes of scenario and episodes and the command that made them,
``dcgrid hindsight``. A scenario that differs from the preset in any field has none.
"""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env import Scenario, episode_hash, scenario_hash


class Published(NamedTuple):
    """The published episodes of a scenario, (n,) each."""

    seeds: np.ndarray
    J: np.ndarray
    """Hindsight's actions, replayed."""
    bound: np.ndarray
    """Optimum of the linear program behind them, see ``hindsight``."""
    episode_hashes: tuple[str, ...]

    def check_episodes(self, scenario: Scenario, n: int) -> None:
        """Raise ValueError unless the first ``n`` episodes are drawn here as they were where the values were made."""
        for seed, expected in list(zip(self.seeds.tolist(), self.episode_hashes, strict=True))[:n]:
            found = episode_hash(scenario, seed)
            if found != expected:
                raise ValueError(
                    f"episode {seed} of {scenario.name!r}, {scenario.split} split, has the hash {found} here and "
                    f"{expected} in the published values; compute them here with `dcgrid hindsight`"
                )


@cache
def _shipped(name: str) -> dict[str, Any] | None:
    path = files("dcgrid_env.baselines.data") / "hindsight" / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None


def published(scenario: Scenario) -> Published | None:
    """The published values of a scenario; None where there are none of exactly this one."""
    found = _shipped(scenario.name)
    if found is None or found["scenario_hash"] != scenario_hash(scenario):
        return None
    episodes = found["episodes"]
    seeds, j, bound = (np.array([e[key] for e in episodes]) for key in ("seed", "J", "bound"))
    return Published(seeds, j, bound, tuple(e["hash"] for e in episodes))
