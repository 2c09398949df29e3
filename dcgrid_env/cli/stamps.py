"""Feeders whose import was not verified: commands refuse them unless they are accepted, and repeat the verdict."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from dcgrid_env.core.commands.names import split_names


@contextmanager
def stamps_respected(allow: str | None) -> Iterator[None]:
    """Refuse feeders without a verified import within the block, or repeat the verdict of those that are accepted.

    Parameters
    ----------
    allow
        The option ``--allow`` of the command, None if it has none.

    Raises
    ------
    FeederError
        With the verdict and how to accept it.
    """
    from dcgrid_env.grid.formats.import_stamp import UNVERIFIED, AcceptedFeederWarning, UnverifiedFeederWarning
    from dcgrid_env.grid.topology import FeederError

    with warnings.catch_warnings():
        show = warnings.showwarning

        def repeated(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
            if issubclass(category, UnverifiedFeederWarning):
                print(f"dcgrid: {message}", file=sys.stderr)
            else:
                show(message, category, *where, **more)

        warnings.showwarning = repeated
        warnings.simplefilter("once", UnverifiedFeederWarning)
        if UNVERIFIED not in split_names(allow or ""):
            warnings.simplefilter("error", UnverifiedFeederWarning)
            warnings.simplefilter("once", AcceptedFeederWarning)
        try:
            yield
        except UnverifiedFeederWarning as warning:
            accept = f"repeat the import with --allow {UNVERIFIED} to accept it"
            option = f"--allow {UNVERIFIED} goes on with it, or " if allow is not None else ""
            raise FeederError(f"{warning}; {option}{accept}") from None
