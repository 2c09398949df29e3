"""Where a command's units of work run: the options that say so, shared by every command that has such units."""

from __future__ import annotations

from abc import ABC
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated

import tyro

from dcgrid_env.cli.command import Command

if TYPE_CHECKING:
    from dcgrid_env.core.work.unit import Place


@dataclass(frozen=True, kw_only=True)
class OverWorkers(Command, ABC):
    """A command whose work comes in units that run side by side."""

    workers: Annotated[int | None, tyro.conf.arg(aliases=("--jobs",))] = None
    """Number of processes on this machine; by default one for each core."""
    ray: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None
    """Ray cluster that does the work instead: auto for the one that this machine is a node of, HOST:PORT of its head,
    or ray://HOST:PORT of its client server (takes the extra ray)."""

    @cached_property
    def place(self) -> Place:
        """Where the units run.

        ValueError for options that cannot be, or other versions on the cluster's nodes; OSError where none answers.
        """
        return place(self.workers, self.ray)


def place(workers: int | None, ray: str | None) -> Place:
    """Where units run as the two options say; errors as ``OverWorkers.place``."""
    from dcgrid_env.core.threads import n_threads
    from dcgrid_env.core.work.local_pool import LocalPool

    if workers is not None and workers < 1:
        raise ValueError(f"workers is {workers}; give at least 1")
    if ray is None:
        return LocalPool(n_threads() if workers is None else workers)
    if workers is not None:
        raise ValueError(f"workers is {workers} and ray {ray!r}; the cluster's cores do the work, leave one out")
    from dcgrid_env.cli.terminal import plain_console, say
    from dcgrid_env.core.work.cluster import cluster

    found = cluster(ray)
    say(plain_console(), f"Ray cluster at {ray}: cores {found.workers}, nodes with cores {len(found.nodes)}")
    return found
