"""Joint actions of whole episodes: how bundled best known costs can be driven again.

A file contains the actions of some episodes in thousandths, as changes from step to step, compressed by xz. Which
episodes these are, and the hash of the file, is in the JSON file of their costs next to it.
"""

from __future__ import annotations

import hashlib
import lzma
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env import Recorder, Scenario, action_layout, scenario_hash
from dcgrid_env.baselines.hindsight_costs import hindsight_file, read_hindsight, shipped_content
from dcgrid_env.baselines.rollout import rollout
from dcgrid_env.core.user_files import read_bytes

LEVELS = 1000
"""Levels of an action from 0 to 1."""
SUFFIX = ".actions.xz"


class RecordedActions:
    """A controller that repeats actions and takes no notice of observations.

    Parameters
    ----------
    actions
        (episode, step, n_action).
    """

    def __init__(self, actions: np.ndarray):
        self._actions, self._step = actions, 0

    def reset(self, env_info: Scenario) -> None:
        """Begin the episodes again."""
        self._step = 0

    def act(self, observations: Any) -> np.ndarray:
        """Return the actions of the next step."""
        self._step += 1
        return self._actions[:, self._step - 1]


def rounded(actions: np.ndarray) -> np.ndarray:
    """Return actions on the levels that a file keeps."""
    return np.rint(np.clip(actions, -1.0, 1.0) * LEVELS) / LEVELS


def packed(actions: np.ndarray) -> bytes:
    """Return the content of a file of actions, (episode, step, n_action) and :func:`rounded`."""
    levels = np.rint(actions * LEVELS).astype("<i2").swapaxes(1, 2)
    return lzma.compress(np.diff(levels, axis=2, prepend=np.int16(0)).tobytes())


def unpacked(content: bytes, shape: tuple[int, int, int]) -> np.ndarray:
    """Return the actions of a file, of this (episode, step, n_action); ValueError for a file that has others."""
    episodes, steps, n = shape
    size = 2 * episodes * steps * n
    try:
        changes = lzma.LZMADecompressor().decompress(content, size + 1)
    except (lzma.LZMAError, EOFError) as error:
        raise ValueError(f"is not a file of xz ({error})") from None
    if len(changes) != size:
        raise ValueError(f"does not contain {episodes} episodes of {steps} steps and {n} actions")
    levels = np.frombuffer(changes, "<i2").reshape(episodes, n, steps).cumsum(axis=2, dtype=np.int64)
    if levels.size and np.abs(levels).max() > LEVELS:
        raise ValueError("has actions beyond -1 to 1")
    return levels.swapaxes(1, 2) / LEVELS


def actions_file(folder: Path, name: str) -> Path:
    """Return where the actions of a scenario of this name are kept."""
    return hindsight_file(folder, name).with_suffix(SUFFIX)


def checksum(content: bytes) -> str:
    """Return what the JSON file says of the file of actions."""
    return hashlib.sha256(content).hexdigest()


def recorded_actions(scenario: Scenario, folder: Path | None = None) -> dict[int, np.ndarray]:
    """Return the actions behind the best known costs of a scenario's episodes, (step, n_action) by seed.

    Parameters
    ----------
    scenario
        With its split. There are none of a scenario that differs in any field.
    folder
        Folder with other files of the same form; bundled actions unless given.

    Raises
    ------
    ValueError
        For a damaged file.
    """
    bundled = files("dcgrid_env.baselines.data") / "hindsight" / f"{scenario.name}{SUFFIX}"
    path = bundled if folder is None else actions_file(folder, scenario.name)
    content = shipped_content(scenario.name) if folder is None else read_hindsight(folder, scenario.name)
    if content is None or "actions_sha256" not in content or content["scenario_hash"] != scenario_hash(scenario):
        return {}
    remedy = "delete it and the JSON file next to it"
    if not path.is_file():
        raise ValueError(f"{path} is missing; {remedy}")
    packed_actions = read_bytes(Path(str(path)), ValueError)
    if checksum(packed_actions) != content["actions_sha256"]:
        raise ValueError(f"{path} is not the file that its JSON file names; {remedy}")
    seeds = [episode["seed"] for episode in content["episodes"]]
    try:
        actions = unpacked(packed_actions, (len(seeds), scenario.horizon, action_layout(scenario).n))
    except ValueError as error:
        raise ValueError(f"{path} {error}; {remedy}") from None
    return dict(zip(seeds, actions, strict=True))


def replayed(scenario: Scenario, seeds: Sequence[int], folder: Path | None = None) -> Recorder:
    """Drive episodes by the actions that reached their best known cost; KeyError for seeds without a record."""
    actions = recorded_actions(scenario, folder)
    return rollout(scenario, RecordedActions(np.stack([actions[seed] for seed in seeds])), seeds, name="best known")
