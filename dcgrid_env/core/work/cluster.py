"""Units on a Ray cluster, as tasks of Ray that this process hands out and whose results it alone collects.

P. Moritz et al., "Ray: a distributed framework for emerging AI applications", OSDI 2018.
"""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import re
import socket
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from dcgrid_env.core.install import from_clone
from dcgrid_env.core.versions import versions
from dcgrid_env.core.work.packing import packed
from dcgrid_env.core.work.unit import TRIES, Lost, Place, Unit
from dcgrid_env.core.work.worker import THREADS

SAME = ("dcgrid-env", "numpy", "scipy", "numba")
"""Packages whose versions must be the same on all nodes, or the bits of results may not be."""
SECONDS_TO_ANSWER = 5.0
"""Time in which a cluster's address must take a connection."""
_ADDRESS = re.compile(r"(?:ray://)?(?P<host>[^\s:/]+|\[[^\s/]+\]):(?P<port>\d+)")
_GB = 1 << 30

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Cluster(Place):
    """The nodes of a Ray cluster that this process is connected to; made by :func:`cluster`."""

    ray: Any
    """The module."""
    address: str
    is_remote = True

    @property
    def workers(self) -> int:
        """Number of cores of all nodes."""
        return max(1, int(self.ray.cluster_resources().get("CPU", 1)))

    @property
    def nodes(self) -> list[dict[str, Any]]:
        """What Ray says of the nodes that are alive and have cores for units."""
        return [node for node in self.ray.nodes() if node["Alive"] and node["Resources"].get("CPU", 0) >= 1]

    def run(
        self, units: Sequence[Unit[Item, Result]], shared: Mapping[str, Any] | None = None
    ) -> Iterator[tuple[Unit[Item, Result], Result | Lost]]:
        """See ``Place.run``; a unit whose node or worker dies is tried again where Ray has room for it."""
        if not units:
            return
        ray, expected = self.ray, versions(SAME)
        values = ray.put(packed(dict(shared or {})))  # into the object store, which keeps one copy a node
        task = ray.remote(_on_a_node())
        pending: dict[Any, tuple[Unit[Item, Result], int]] = {}

        def submit(unit: Unit[Item, Result], tries: int) -> None:
            options = {"num_cpus": unit.needs.cores, "max_retries": 0, "scheduling_strategy": "SPREAD"}
            options |= {"num_gpus": unit.needs.gpus} if unit.needs.gpus else {}
            options |= {"memory": int(unit.needs.memory_gb * _GB)} if unit.needs.memory_gb else {}
            # The reference stands in a list, so that Ray leaves it to the worker to ask for what it stands for.
            sent = task.options(**options).remote(packed((unit.work, unit.item)), [values], expected, sys.argv)
            pending[sent] = unit, tries

        try:
            for unit in units:
                submit(unit, 1)
            while pending:
                (done,), _ = ray.wait(list(pending), num_returns=1)
                unit, tries = pending.pop(done)
                try:
                    result = ray.get(done)
                except ray.exceptions.RayTaskError as error:
                    result = Lost(_last_line(error), RuntimeError(str(error)))
                except ray.exceptions.RayError as error:  # its worker or its node is gone, or the result with it
                    if tries < TRIES:
                        submit(unit, tries + 1)
                        continue
                    result = Lost(f"its worker died {TRIES} times, at last: {_first_line(error)}")
                yield unit, result
        finally:
            for sent in pending:
                with contextlib.suppress(Exception):
                    ray.cancel(sent, force=True)


def cluster(address: str) -> Cluster:
    """Connect to a Ray cluster, on all of whose nodes the same versions of this package and of its libraries stand.

    Parameters
    ----------
    address
        ``auto`` for the cluster that this machine is a node of; ``HOST:PORT`` likewise, by its head; or
        ``ray://HOST:PORT``, a cluster's client server, from a machine outside it.

    Raises
    ------
    ValueError
        For an address that cannot be, where Ray is not installed, or nodes that have other versions, by their names.
    OSError
        Where no cluster answers.
    """
    _check(address)
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # what Ray would do else comes with a warning
    try:
        ray = importlib.import_module("ray")
    except ImportError as error:
        raise ValueError(f"ray: {error}; install it {from_clone('ray')}") from None
    if not ray.is_initialized():
        try:
            ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
        except Exception as error:  # of many kinds, whatever is not there
            raise OSError(
                f"ray: no cluster could be reached at {address!r} ({_first_line(error)}); start one with `ray start "
                "--head`, or give the address of one that runs"
            ) from None
    found = Cluster(ray, address)
    _require_same_versions(found)
    return found


def _check(address: str) -> None:
    """ValueError for an address of no known form, OSError where nobody listens there."""
    if address == "auto":
        return
    match = _ADDRESS.fullmatch(address)
    if match is None or not 0 < int(match["port"]) < 1 << 16:
        raise ValueError(f"ray is {address!r}; give auto, HOST:PORT, or ray://HOST:PORT")
    try:
        socket.create_connection((match["host"].strip("[]"), int(match["port"])), SECONDS_TO_ANSWER).close()
    except OSError as error:
        why = error.strerror or str(error)
        raise OSError(
            f"ray: no cluster could be reached at {address!r} ({why}); start one with `ray start --head`, or give the "
            "address of one that runs"
        ) from None


def _require_same_versions(found: Cluster) -> None:
    """ValueError, naming the nodes, unless all have the versions of ``SAME`` that stand here."""
    ray, expected, nodes = found.ray, versions(SAME), found.nodes
    if not nodes:
        raise ValueError(f"ray: the cluster at {found.address!r} has no node with a core for work; add one")
    strategy = importlib.import_module("ray.util.scheduling_strategies").NodeAffinitySchedulingStrategy
    ask = ray.remote(_versions_on_a_node())
    asked = {
        node["NodeManagerAddress"] + " " + node["NodeID"][:8]: ask.options(
            num_cpus=0, max_retries=0, scheduling_strategy=strategy(node["NodeID"], soft=False)
        ).remote(SAME)
        for node in nodes
    }
    others = []
    for name, answer in asked.items():
        try:
            has = ray.get(answer)
        except ray.exceptions.RayError as error:
            raise OSError(f"ray: node {name} does not answer ({_first_line(error)})") from None
        others += [
            f"{name} has {package} {has.get(package) or 'not installed'}, here is {version}"
            for package, version in expected.items()
            if has.get(package) != version
        ]
    if others:
        raise ValueError(f"ray: {'; '.join(others)}; install the same on all nodes")


def _versions_on_a_node() -> Callable[..., Any]:
    """A function that workers get whole, as they may lack this package: the versions of packages there."""

    def installed(packages: tuple[str, ...]) -> dict[str, str | None]:
        from importlib.metadata import PackageNotFoundError, version

        found: dict[str, str | None] = {}
        for package in packages:
            try:
                found[package] = version(package)
            except PackageNotFoundError:
                found[package] = None
        return found

    return installed


def _on_a_node() -> Callable[..., Any]:
    """A function that workers get whole, as threads are to be set before anything of this package is imported."""
    threads = THREADS

    def unit(pickled: bytes, values: list[Any], expected: dict[str, str | None], argv: list[str]) -> Any:
        import os
        import pickle
        import sys

        os.environ.update(dict.fromkeys(threads, "1"))
        import ray

        from dcgrid_env.core.work import worker

        if why := worker.other_versions(expected):  # of a node that has joined since
            return worker.Lost(why)
        sys.argv = list(argv)
        worker.share_once(values[0].hex(), lambda: pickle.loads(ray.get(values[0])))
        work, item = pickle.loads(pickled)
        return worker.attempt(work, item)

    return unit


def _first_line(error: BaseException) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0][:200] if lines else type(error).__name__


def _last_line(error: BaseException) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1][:200] if lines else type(error).__name__
