"""Options for where a command's units of work run: local processes or a Ray cluster."""

from __future__ import annotations

from abc import ABC
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated

import tyro

from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.option_limits import check_limit

if TYPE_CHECKING:
    from dcgrid_env.core.work.unit import Place


@dataclass(frozen=True, kw_only=True)
class OverWorkers(Command, ABC):
    """A command whose work is split into units that run in parallel."""

    workers: Annotated[int | None, tyro.conf.arg(aliases=("--jobs",))] = None
    """Number of worker processes on this machine. Default: one per core."""
    ray: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None
    """Ray cluster to run on instead: auto (the cluster of this machine), HOST:PORT of the head node, or
    ray://HOST:PORT of the client server. Requires the ray extra."""

    @cached_property
    def place(self) -> Place:
        """Return where the units run.

        Raises ValueError if an option is invalid, and OSError if no cluster answers.
        """
        return place(self.workers, self.ray)


def place(workers: int | None, ray: str | None) -> Place:
    """Return where units run with these two options; the errors are those of ``OverWorkers.place``."""
    from dcgrid_env.core.threads import n_threads
    from dcgrid_env.core.work.local_pool import LocalPool

    if workers is not None:
        check_limit("workers", workers)
    if ray is None:
        return LocalPool(n_threads() if workers is None else workers)
    if workers is not None:
        raise ValueError(
            f"workers: must not be combined with --ray, got --workers {workers} and --ray {ray!r}; remove one of them"
        )
    from dcgrid_env.core.commands.terminal import plain_console, say
    from dcgrid_env.core.work.cluster import cluster

    found = cluster(ray)
    say(plain_console(), f"Ray cluster at {ray}, cores: {found.workers}")
    return found
