"""Read the hindsight costs of episodes: the bundled ones of the presets' test episodes, and those of user scenarios.

The costs of the presets are in ``data/hindsight/<preset>.json``, with the hashes of scenario and episodes and the
command that made them, ``dcgrid hindsight``. That command writes the costs of other scenarios into a folder, in the
same form. They apply only to exactly the same scenario: none of them is used if any field differs.

Where regulators act within steps, and where sites trip or agents smooth their power, a search finds the costs. Its
result may be more than 0.1 % above the least cost; the ``kind`` of the file is then "best known". No linear program
describes trips and smoothing. Files of such presets have no bounds, and their actions are in ``recorded_actions``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env import Scenario, episode_hash, scenario_hash
from dcgrid_env.baselines.file_names import file_name
from dcgrid_env.core.user_files import read_json

FOLDER = Path("results/hindsight")
"""Where ``dcgrid hindsight`` writes by default, in the working directory."""
FIELDS = {"seed": int, "hash": str, "J": float, "bound": float, "rounds": int}
"""Fields of an episode's record in a file with bounds, with their types."""
FIELDS_WITHOUT_BOUND = {"seed": int, "hash": str, "J": float, "start": str, "rounds": int}
"""Fields of an episode's record in a file without bounds, with their types."""
BEST_KNOWN = "best known"
"""Value of ``kind`` in a file of best-known costs; files of hindsight have no ``kind``."""


class Published(NamedTuple):
    """Solved episodes of a scenario, (n,) each."""

    seeds: np.ndarray
    J: np.ndarray
    """Cost of replaying the hindsight actions; without hindsight the best known cost."""
    bound: np.ndarray
    """Optimum of the linear program behind the actions, see ``hindsight``; -inf without one."""
    episode_hashes: tuple[str, ...]
    is_best_known: bool = False
    """Whether the costs are best-known costs, which a controller may beat, instead of hindsight costs."""

    def missing(self, seeds: Iterable[int]) -> list[int]:
        """Return the seeds that have not been solved."""
        solved_seeds = set(self.seeds.tolist())
        return [seed for seed in seeds if seed not in solved_seeds]

    def select(self, seeds: Sequence[int]) -> Published:
        """Return the episodes of the given seeds, in that order; all must have been solved."""
        position = {int(seed): i for i, seed in enumerate(self.seeds)}
        index = [position[seed] for seed in seeds]
        hashes = tuple(self.episode_hashes[i] for i in index)
        return Published(self.seeds[index], self.J[index], self.bound[index], hashes, self.is_best_known)

    def check_episodes(self, scenario: Scenario, n: int) -> None:
        """Raise ValueError unless the first ``n`` episodes are drawn as they were when the values were computed."""
        for seed, expected in list(zip(self.seeds.tolist(), self.episode_hashes, strict=True))[:n]:
            drawn_hash = episode_hash(scenario, seed)
            if drawn_hash != expected:
                raise ValueError(
                    f"episode {seed} of {scenario.name!r}, {scenario.split} split, has the hash {drawn_hash} here and "
                    f"{expected} in the published values; compute them here with `dcgrid hindsight`"
                )


@cache
def shipped_content(name: str) -> dict[str, Any] | None:
    """Return the content of a preset's bundled file; None if there is none."""
    path = files("dcgrid_env.baselines.data") / "hindsight" / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None


def published(scenario: Scenario, folder: Path | None = None) -> Published | None:
    """Return the hindsight costs for the episodes of a scenario; None if exactly this scenario has none.

    Parameters
    ----------
    scenario
        Scenario with its split; the split determines the episode of each seed.
    folder
        Additional folder of ``dcgrid hindsight`` files; the bundled costs take precedence.

    Raises
    ------
    ValueError
        If the scenario's file in the folder is damaged; a file of another scenario of that name is ignored.
    """
    episodes = records(scenario, folder)
    if not episodes:
        return None
    seeds, j, bound = (np.array([e.get(key, -np.inf) for e in episodes]) for key in ("seed", "J", "bound"))
    is_best_known = any(e["is_best_known"] for e in episodes)
    return Published(seeds, j, bound, tuple(e["hash"] for e in episodes), is_best_known)


def records(scenario: Scenario, folder: Path | None = None) -> list[dict[str, Any]]:
    """Return the records of the episodes of exactly this scenario, by seed; ``published`` converts them to arrays.

    Each has ``is_best_known`` from the kind of its file.
    """
    about, solved = scenario_hash(scenario), {}
    for content in (folder and read_hindsight(folder, scenario.name), shipped_content(scenario.name)):
        if content and content["scenario_hash"] == about:
            is_best_known = content.get("kind") == BEST_KNOWN
            solved |= {one["seed"]: one | {"is_best_known": is_best_known} for one in content["episodes"]}
    return [solved[seed] for seed in sorted(solved)]


def is_without_bounds(content: Mapping[str, Any]) -> bool:
    """Return whether a file has best-known costs of a search over actions, which gives no bounds."""
    bounded = any(isinstance(episode, dict) and "bound" in episode for episode in content["episodes"])
    return content.get("kind") == BEST_KNOWN and not bounded


def hindsight_file(folder: Path, name: str) -> Path:
    """Return the path of the file for a scenario of this name."""
    return folder / f"{file_name(name)}.json"


def read_hindsight(folder: Path, name: str) -> dict[str, Any] | None:
    """Read a scenario's file with its ``scenario_hash`` and ``episodes``; None if the file does not exist.

    Raises ValueError if the file is damaged, naming the file and the remedy.
    """
    path = hindsight_file(folder, name)
    if not path.exists():
        return None
    content = read_json(path, ValueError, _DAMAGED)
    if not isinstance(content, dict) or not {"scenario_hash", "episodes"} <= set(content):
        raise _damaged(path, "has no 'scenario_hash' and 'episodes'")
    if not isinstance(content["episodes"], list):
        raise _damaged(path, "has 'episodes' that are no list")
    fields = FIELDS_WITHOUT_BOUND if is_without_bounds(content) else FIELDS
    for place, episode in enumerate(content["episodes"]):
        if wrong := _wrong(episode, fields):
            raise _damaged(path, f"has {wrong} in its episode at place {place}")
    return content


_DAMAGED = "delete it, or choose another --out"


def _damaged(path: Path, wrong: str) -> ValueError:
    return ValueError(f"{path} {wrong}; {_DAMAGED}")


def _wrong(episode: object, fields: Mapping[str, type]) -> str | None:
    """Describe the first missing or invalid entry of an episode's record; None if it is complete."""
    if not isinstance(episode, dict):
        return "no record"
    for key, kind in fields.items():
        if key not in episode:
            return f"no {key!r}"
        value = episode[key]
        if not isinstance(value, kind) or (kind is float and not math.isfinite(value)):
            return f"{key} = {value!r}"
    return None
