"""Data sets on disk in Minari's layout: ROOT/ID/data for ``minari.load_dataset``, and its card ROOT/ID/card.json.

Minari is imported when a data set is written. Episodes are those of the joint environment, see
docs/decisions/0020-offline-data.md.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec

from dcgrid_env import IDS, Scenario, episode_hash
from dcgrid_env.baselines.file_names import file_name
from dcgrid_env.baselines.offline_data.joint_episodes import JointEpisode, agent_layout
from dcgrid_env.core.files import naming, new_folder, require_space, whole_folder, write_json
from dcgrid_env.core.lock import locked
from dcgrid_env.core.suggestions import from_clone

if TYPE_CHECKING:
    from collections.abc import Iterator

REMEDY = from_clone("minari")
ROOT_VARIABLE = "MINARI_DATASETS_PATH"
"""Environment variable with the folder of Minari's data sets."""
CARD = "card.json"
AGENTS = "agents"
"""Key of Minari's metadata with each agent's place in the joint observation and action."""
EPISODE_BYTES = 2**18
"""Bytes that HDF5 takes for the names and layout of an episode, at most."""
_SAFE_NAME = re.compile(r"[A-Za-z0-9_-]+")


def require_minari() -> None:
    """ValueError, saying what to install, where Minari or what it writes HDF5 with is missing."""
    for package in ("minari", "h5py"):
        try:
            importlib.import_module(package)
        except ImportError:
            raise ValueError(f"data sets are written with {package}, which is not installed; {REMEDY}") from None


def default_root() -> Path:
    """Return the default folder of data sets: that of Minari's environment variable, or results/datasets."""
    return Path(os.environ.get(ROOT_VARIABLE) or "results/datasets")


def dataset_id(scenario: Scenario, name: str) -> str:
    """What Minari calls the data of a scenario: ``dcgrid/SCENARIO/NAME-v0``.

    ValueError for a name of other signs than letters, digits, - and _.
    """
    if not _SAFE_NAME.fullmatch(name) or name.startswith("-"):
        raise ValueError(f"name is {name!r}; give letters, digits, - and _ only, and no - in front")
    return f"dcgrid/{file_name(scenario.name)}/{name}-v0"


def env_spec(scenario: Scenario) -> EnvSpec:
    """The spec from which ``minari`` makes the environment of a data set again.

    ScenarioError for a scenario that holds what JSON cannot, a recording made in Python for instance.
    """
    registered = {name: env_id for env_id, name in IDS.items()}
    env_id = registered.get(scenario.name) or f"dcgrid/{file_name(scenario.name)}-v0"
    env = gymnasium.make(replace(gymnasium.spec(next(iter(IDS))), id=env_id, kwargs={"scenario": scenario}))
    try:
        spec = env.spec
        assert spec is not None
        spec.to_json()
        return spec
    finally:
        env.close()


@contextmanager
def new_dataset(root: Path, name: str, scenario: Scenario, algorithm: str) -> Iterator[DatasetWriter]:
    """Write a data set: it is at ``root / name``, with all of it, once the block has ended without an error.

    Parameters
    ----------
    root
        Folder of all data sets.
    name
        What ``dataset_id`` gives.
    scenario
        What the episodes are of.
    algorithm
        What acts in them.

    Raises
    ------
    ValueError
        Where there is one of that name, or Minari is not installed.
    OSError
        Where it cannot be written, or another process writes it.
    """
    require_minari()
    folder = root / name
    remedy = "give another --name, or wait until it has ended"
    with new_folder(folder.parent), locked(folder.parent, "data set", remedy, f".{folder.name}"):
        if folder.exists():
            raise ValueError(f"{folder} is there already; give another --name, or delete it")
        with whole_folder(folder) as part, naming(folder):
            yield DatasetWriter(part, name, scenario, algorithm)


class DatasetWriter:
    """Writer of a data set in a new folder; made by :func:`new_dataset`."""

    def __init__(self, folder: Path, name: str, scenario: Scenario, algorithm: str):
        storage: Any = importlib.import_module("minari.dataset.minari_storage")
        self._buffer = importlib.import_module("minari.data_collector").EpisodeBuffer
        spec = env_spec(scenario)
        env = gymnasium.make(spec)
        data = folder / "data"
        self._scenario, self._folder, self._digest = scenario, folder, hashlib.sha256()
        self._storage = storage.MinariStorage.new(data, env.observation_space, env.action_space, spec, "hdf5")
        env.close()
        self._storage.update_metadata(
            {
                "dataset_id": name,
                "minari_version": importlib.import_module("minari").__version__,
                "algorithm_name": algorithm,
                "description": (
                    f"Episodes of {scenario.name} ({scenario.split} split) under {algorithm}, all agents' observations "
                    f"and actions joined in the order of {AGENTS!r}; the card is {CARD}."
                ),
                AGENTS: agent_layout(scenario),
            }
        )

    def add(self, episodes: Sequence[JointEpisode]) -> None:
        """Append episodes, in order."""
        first = self._storage.total_episodes
        # HDF5 ends the process where it cannot write.
        require_space(self._folder, EPISODE_BYTES * len(episodes) + 2 * _bytes_of(episodes), self._size)
        self._storage.update_episodes(map(self._as_buffer, episodes))
        for episode in episodes:
            for array in (np.int64(episode.seed), episode.observations, episode.actions, episode.rewards):
                self._digest.update(array.tobytes())
        about = [self._about(episode) for episode in episodes]
        self._storage.update_episode_metadata(about, range(first, first + len(episodes)))

    @property
    def _size(self) -> int:
        """Bytes that are written."""
        return sum(path.stat().st_size for path in self._folder.rglob("*") if path.is_file())

    def _as_buffer(self, episode: JointEpisode) -> Any:
        return self._buffer(
            seed=episode.seed,
            observations=episode.observations,
            actions=episode.actions,
            rewards=episode.rewards,
            terminations=episode.terminations,
            truncations=episode.truncations,
            infos=dict(episode.infos),
        )

    def _about(self, episode: JointEpisode) -> dict[str, Any]:
        """Minari's metadata of an episode, which is stored in addition to its steps."""
        buses = {f"buses/{agent}": bus for agent, bus in episode.buses.items()}
        about = {"J": episode.J, "controller": episode.controller}
        return about | {"episode_hash": episode_hash(self._scenario, episode.seed), **buses}

    def describe(self, card: Mapping[str, Any]) -> None:
        """Write the card with ``sha256``, the digest of seeds, observations, actions and rewards.

        ValueError for a NaN in it.
        """
        write_json(self._folder / CARD, {**card, "sha256": self._digest.hexdigest()})


def _bytes_of(episodes: Sequence[JointEpisode]) -> int:
    """Bytes of the arrays of episodes."""
    arrays = (array for episode in episodes for array in (*vars(episode).values(), *episode.infos.values()))
    return sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))


def envs_at_once(horizon: int) -> int:
    """How many episodes to run side by side, so that memory does not grow with their length or number."""
    return int(min(max(1_000_000 // horizon, 1), 64))


def batches(seeds: Sequence[int], horizon: int) -> Iterable[Sequence[int]]:
    """Seeds in batches of ``envs_at_once``."""
    n = envs_at_once(horizon)
    return (seeds[first : first + n] for first in range(0, len(seeds), n))
