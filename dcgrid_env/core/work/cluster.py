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
import time
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from dcgrid_env.core.install import from_clone
from dcgrid_env.core.versions import command_words
from dcgrid_env.core.work.packing import all_packed, packed
from dcgrid_env.core.work.unit import TRIES, Lost, Place, Unit
from dcgrid_env.core.work.worker import THREADS

SAME = ("dcgrid-env", "numpy", "scipy", "numba")
"""Packages whose versions must be the same on all nodes, or the bits of results may not be."""
SECONDS_TO_ANSWER = 5.0
"""Time in which a cluster's address must take a connection."""
SECONDS_TO_LEAVE = 60.0
"""Time in which Ray must notice that a node which does not answer has gone."""
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
    own_connection: bool = False
    """Whether :func:`cluster` made the connection, so that it may also end it."""
    is_remote = True

    @property
    def workers(self) -> int:
        """Number of cores of all nodes."""
        return max(1, int(self.ray.cluster_resources().get("CPU", 1)))

    @property
    def nodes(self) -> list[dict[str, Any]]:
        """Ray's description of the nodes that are alive and have cores for units."""
        return [node for node in self.ray.nodes() if node["Alive"] and node["Resources"].get("CPU", 0) >= 1]

    def waits_for(self, units: Sequence[Unit[Any, Any]]) -> str:
        """What no node has that units take, which then wait for a node with it; empty where all have room."""
        has, lacking = [node["Resources"] for node in self.nodes], []
        for needs in dict.fromkeys(unit.needs for unit in units):
            wanted = {"CPU": needs.cores, "GPU": needs.gpus, "memory": needs.memory_gb * _GB}
            if not any(all(resources.get(what, 0) >= n for what, n in wanted.items()) for resources in has):
                memory = [f"{needs.memory_gb:g} GB of memory"] if needs.memory_gb else []
                listed = [f"{n:g} {what}" for what, n in wanted.items() if n and what != "memory"] + memory
                first = next(unit.key for unit in units if unit.needs == needs)
                lacking.append(f"{', '.join(listed)} for {first}")
        return f"ray: no node of the cluster has {'; or '.join(lacking)}; they wait until one joins" if lacking else ""

    def run(
        self, units: Sequence[Unit[Item, Result]], shared: Mapping[str, Any] | None = None
    ) -> Iterator[tuple[Unit[Item, Result], Result | Lost]]:
        """See ``Place.run``; a unit whose node or worker dies is tried again where Ray has room for it."""
        if not units:
            return
        if waiting := self.waits_for(units):
            warnings.warn(waiting, stacklevel=2)
        ray, expected = self.ray, _asked()(SAME)
        if self.own_connection and not ray.is_initialized():  # an earlier run ended before its units did
            _connect(ray, self.address)
        values = ray.put(packed(dict(shared or {})))  # into the object store, which keeps one copy a node
        task = ray.remote(_on_a_node())
        pending: dict[Any, tuple[Unit[Item, Result], bytes, int]] = {}

        def submit(unit: Unit[Item, Result], pickled: bytes, tries: int) -> None:
            options = {"num_cpus": unit.needs.cores, "max_retries": 0, "scheduling_strategy": "SPREAD"}
            options |= {"num_gpus": unit.needs.gpus} if unit.needs.gpus else {}
            options |= {"memory": int(unit.needs.memory_gb * _GB)} if unit.needs.memory_gb else {}
            # The reference stands in a list, so that Ray leaves it to the worker to ask for what it stands for.
            sent = task.options(**options).remote(pickled, [values], expected, command_words())
            pending[sent] = unit, pickled, tries

        ready: list[Any] = []
        try:
            for unit, pickled in zip(units, all_packed((unit.work, unit.item) for unit in units), strict=True):
                submit(unit, pickled, 1)
            while pending:
                if not ready:
                    ray.wait(list(pending), num_returns=1)
                    ready, _ = ray.wait(list(pending), num_returns=len(pending), timeout=0)
                done = ready.pop(0)
                unit, pickled, tries = pending.pop(done)
                try:
                    result = ray.get(done)
                except ray.exceptions.RayTaskError as error:
                    result = Lost(_last_line(error), RuntimeError(str(error)))
                except ray.exceptions.RayError as error:  # its worker or its node is gone, or the result with it
                    if tries < TRIES:
                        submit(unit, pickled, tries + 1)
                        continue
                    result = Lost(f"its worker died {TRIES} times, at last: {_first_line(error)}")
                yield unit, result
        finally:
            if pending:
                self._stop(pending)

    def _stop(self, pending: Collection[Any]) -> None:
        """End units that nobody waits for.

        Leaving the cluster ends them. Ray can abort the whole process if a unit is cancelled in the moment in which its
        result arrives (ray-project/ray, pull request 54798), so units are cancelled only under another's connection.
        """
        if self.own_connection:
            self.ray.shutdown()
            return
        for sent in pending:
            with contextlib.suppress(Exception):
                self.ray.cancel(sent, force=True)


def cluster(address: str) -> Cluster:
    """Connect to a Ray cluster whose nodes all have the same versions of this package and of its libraries.

    Parameters
    ----------
    address
        ``auto`` for the cluster that this machine is a node of; ``HOST:PORT`` likewise, by its head; or
        ``ray://HOST:PORT``, a cluster's client server, from a machine outside it.

    Raises
    ------
    ValueError
        If the address is invalid, Ray is not installed, or nodes have other versions; the message names the nodes.
    OSError
        If no cluster answers.
    """
    _check(address)
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_DEDUP_LOGS_SKIP_REGEX", ".")  # what raylets say of workers that died; it is told here
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # what Ray would do else comes with a warning
    try:
        ray = importlib.import_module("ray")
    except ImportError as error:
        raise ValueError(f"ray: {error}; install it {from_clone('ray')}") from None
    own_connection = not ray.is_initialized()
    if own_connection:
        _connect(ray, address)
    found = Cluster(ray, address, own_connection)
    _require_same_code(found)
    return found


def _connect(ray: Any, address: str) -> None:
    """OSError where no cluster answers."""
    try:
        with warnings.catch_warnings(action="ignore"):
            ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    except Exception as error:  # of many kinds, whatever is not there
        raise _unreachable(address, _first_line(error)) from None


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
        raise _unreachable(address, error.strerror or str(error)) from None


def _unreachable(address: str, why: str) -> OSError:
    token = "; where the cluster asks for a token, set RAY_AUTH_MODE=token" if address != "auto" else ""
    return OSError(
        f"ray: no cluster could be reached at {address!r} ({why}); start one with `ray start --head`, or give the "
        f"address of one that runs{token}"
    )


def _require_same_code(found: Cluster) -> None:
    """ValueError, naming the nodes, unless all have this package's code and the versions of ``SAME`` that are here."""
    ray, expected, nodes = found.ray, _asked()(SAME), found.nodes
    if not nodes:
        raise ValueError(f"ray: the cluster at {found.address!r} has no node with a core for work; add one")
    ask, others = ray.remote(_asked()), []
    for node, answer in [(node, _sent(ask, node)) for node in nodes]:  # all are asked before the first answer
        has = _answered(found, ask, node, answer)
        differ = [f"{what} {has[what]}, here {here}" for what, here in expected.items() if has and has[what] != here]
        if differ:
            others.append(f"node {_named(node)} has {', '.join(differ)}")
    if others:
        raise ValueError(f"ray: {'; '.join(others)}; install the same on all nodes")


def _sent(ask: Any, node: Mapping[str, Any]) -> Any:
    """Ask a node, and nobody else, for its software; return Ray's reference to the answer."""
    strategy = importlib.import_module("ray.util.scheduling_strategies").NodeAffinitySchedulingStrategy
    there = {"num_cpus": 0, "max_retries": 0, "scheduling_strategy": strategy(node["NodeID"], soft=False)}
    return ask.options(**there).remote(SAME)


def _named(node: Mapping[str, Any]) -> str:
    return f"{node['NodeManagerAddress']} ({node['NodeID'][:8]})"


def _answered(found: Cluster, ask: Any, node: Mapping[str, Any], answer: Any) -> dict[str, str | None]:
    """Return a node's answer; nothing for a node that has died, which Ray lists as alive until it notices."""
    until = time.monotonic() + SECONDS_TO_LEAVE
    while True:
        try:
            return found.ray.get(answer)
        except found.ray.exceptions.RayError as error:
            if node["NodeID"] not in {alive["NodeID"] for alive in found.nodes}:
                return {}
            if time.monotonic() > until:
                raise OSError(f"ray: node {_named(node)} does not answer ({_first_line(error)})") from None
        time.sleep(1.0)
        answer = _sent(ask, node)


def _asked() -> Callable[[tuple[str, ...]], dict[str, str | None]]:
    """Return a self-contained function that reports the software of a node, which may lack this package.

    It returns versions of packages, None for one that is not installed, and a hash of this package's code, which can
    differ between nodes with equal versions.
    """

    def installed(packages: tuple[str, ...]) -> dict[str, str | None]:
        import hashlib
        from importlib.metadata import PackageNotFoundError, version
        from importlib.util import find_spec
        from pathlib import Path

        found: dict[str, str | None] = {}
        for package in packages:
            try:
                found[package] = version(package)
            except PackageNotFoundError:
                found[package] = None
        digest = hashlib.sha256()
        for package in ("dcgrid_env", "dcgrid_env.traces", "dcgrid_env.baselines", "dcgrid_env.agents"):
            try:
                spec = find_spec(package)
            except ModuleNotFoundError:
                spec = None
            for folder in (spec and spec.submodule_search_locations) or ():
                for path in sorted(Path(folder).rglob("*.py")):
                    digest.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
        return {**found, "code of dcgrid": digest.hexdigest()[:8]}

    return installed


def _on_a_node() -> Callable[..., Any]:
    """A function that workers get whole, as threads are to be set before anything of this package is imported."""
    threads, same, installed = THREADS, SAME, _asked()

    def unit(pickled: bytes, values: list[Any], expected: dict[str, str | None], words: tuple[str, ...]) -> Any:
        import os
        import pickle
        from importlib import import_module

        ray = import_module("ray")
        os.environ.update(dict.fromkeys(threads, "1"))
        if os.environ.get("DCGRID_CODE_SEEN") != str(expected):  # once in a process: a node may have joined just now
            if (has := installed(same)) != expected:
                raise ImportError(f"node {ray.util.get_node_ip_address()} has {has}, the others {expected}")
            os.environ["DCGRID_CODE_SEEN"] = str(expected)
        from dcgrid_env.core.versions import command_of
        from dcgrid_env.core.work import worker

        worker.share_once(values[0].hex(), lambda: pickle.loads(ray.get(values[0])))
        work, item = pickle.loads(pickled)
        with command_of(words):
            return worker.attempt(work, item)

    return unit


def _first_line(error: BaseException) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0][:200] if lines else type(error).__name__


def _last_line(error: BaseException) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1][:200] if lines else type(error).__name__
