"""Units as tasks of a Ray cluster, which repeats those whose worker dies (three times, Ray's default).

P. Moritz et al., "Ray: a distributed framework for emerging AI applications", OSDI 2018.
"""

from __future__ import annotations

import hashlib
import importlib
import logging
import os
import pickle
import re
import socket
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from dcgrid_env.core.suggestions import from_clone
from dcgrid_env.core.versions import PACKAGES, command_of, command_words, versions
from dcgrid_env.core.work.unit import ONE_THREAD, Item, Lost, Place, Result, Unit, attempt, packed, share, shared

_SECONDS_TO_ANSWER = 5.0
"""Time in which a cluster's address must accept a connection."""
_ADDRESS = re.compile(r"auto|(?:ray://)?(?P<host>[^\s:/]+|\[[^\s/]+\]):(?P<port>\d{1,5})")
_QUIET = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_DEDUP_LOGS_SKIP_REGEX": ".", "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}
"""Environment variables without which Ray warns, or reports workers that died."""
_REFERENCE = "reference"


@dataclass(frozen=True, kw_only=True)
class Cluster(Place):
    """The nodes of a Ray cluster that this process is connected to; made by :func:`cluster`."""

    ray: Any
    """The module."""
    is_remote = True

    def run(
        self, units: Sequence[Unit[Item, Result]], shared: Mapping[str, Any] | None = None
    ) -> Iterator[tuple[Unit[Item, Result], Result | Lost]]:
        """See ``Place.run``; a unit waits for a node with its cores and GPUs."""
        ray = self.ray
        task = ray.remote(scheduling_strategy="SPREAD", runtime_env={"env_vars": ONE_THREAD})(_attempt)
        values = ray.put(packed([dict(shared or {})])[0])  # the object store keeps one copy on each node
        pending: dict[Any, Unit[Item, Result]] = {}
        try:
            for unit, content in zip(units, packed((unit.work, unit.item) for unit in units), strict=True):
                sized = task.options(num_cpus=unit.cores, num_gpus=unit.gpus)
                # Ray passes a reference in a list unchanged, so a worker reads the values once.
                pending[sized.remote(content, [values], _software(), command_words())] = unit
            while pending:
                (done,), _ = ray.wait(list(pending))
                try:
                    result = ray.get(done)
                except ray.exceptions.RayError as error:
                    result = Lost(_line(error, -1 if isinstance(error, ray.exceptions.RayTaskError) else 0), str(error))
                yield pending.pop(done), result
        finally:
            for sent in pending:
                ray.cancel(sent, force=True)


def _attempt(content: bytes, values: list[Any], expected: dict[str, str | None], words: tuple[str, ...]) -> Any:
    """Run a unit on a node; raise ImportError if its software is not the expected one."""
    ray = importlib.import_module("ray")
    here = _software()
    if differ := [f"{name} {here[name]}, not {wanted}" for name, wanted in expected.items() if here[name] != wanted]:
        node = ray.util.get_node_ip_address()
        raise ImportError(f"ray: node {node} has {', '.join(differ)}; install the same on all nodes")
    if shared(_REFERENCE) != values[0]:
        share(pickle.loads(ray.get(values[0])) | {_REFERENCE: values[0]})
    work, item = pickle.loads(content)
    with command_of(words):
        return attempt(work, item)


@cache
def _software() -> dict[str, str | None]:
    """Return versions, and a hash of this package's code, which differs between clones of one version."""
    found = hashlib.sha256()
    for package in ("dcgrid_env", *(f"dcgrid_env.{name}" for name in ("agents", "apps", "baselines", "traces"))):
        for folder in getattr(find_spec(package), "submodule_search_locations", None) or ():
            for path in sorted(Path(folder).rglob("*.py")):
                found.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
    return versions(PACKAGES) | {"code of dcgrid": found.hexdigest()[:8]}


def cluster(address: str) -> Cluster:
    """Connect to a Ray cluster.

    ``address`` is ``auto`` for the cluster of which this machine is a node, ``HOST:PORT`` of its head, or
    ``ray://HOST:PORT`` of a cluster's client server. Raises ValueError if it is invalid or Ray is not installed, and
    OSError if no cluster answers.
    """
    match = _ADDRESS.fullmatch(address)
    if match is None or not 0 < int(match["port"] or 1) < 1 << 16:
        raise ValueError(f"ray is {address!r}; give auto, HOST:PORT, or ray://HOST:PORT")
    os.environ.update(_QUIET | dict(os.environ))
    try:
        if match["host"]:  # Ray waits for minutes, or ends the process, where nothing listens
            socket.create_connection((match["host"].strip("[]"), int(match["port"])), _SECONDS_TO_ANSWER).close()
        ray = importlib.import_module("ray")
        with warnings.catch_warnings(action="ignore"):
            ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR, ignore_reinit_error=True)
    except ImportError as error:
        raise ValueError(f"ray: {error}; install it {from_clone('ray')}") from None
    except Exception as error:  # of many kinds
        raise OSError(
            f"ray: no cluster could be reached at {address!r} ({_line(error, 0)}); start one with `ray start --head`, "
            "or give the address of one that runs; where the cluster asks for a token, set RAY_AUTH_MODE=token"
        ) from None
    return Cluster(max(1, int(ray.cluster_resources().get("CPU", 1))), ray=ray)


def _line(error: BaseException, number: int) -> str:
    """Return a line of the message of an error, at most 200 characters."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[number][:200] if lines else type(error).__name__
