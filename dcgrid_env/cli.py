"""The command line: ``dcgrid run``, ``dcgrid list``. The one module that sees all others; it imports them lazily."""

from __future__ import annotations

import sys
from typing import Annotated

import tyro

from dcgrid_env.commands import listing, run

Command = (
    Annotated[run.Run, tyro.conf.subcommand("run", description=run.__doc__)]
    | Annotated[listing.List, tyro.conf.subcommand("list", description=listing.__doc__)]
)
_MAIN = {run.Run: run.main, listing.List: listing.main}


def main(args: list[str] | None = None) -> None:
    """Entry point of ``dcgrid``; bad input ends with one line on standard error and status 2."""
    command = tyro.cli(Command, args=args, prog="dcgrid", description="Voltage control of feeders with data centres.")
    try:
        _MAIN[type(command)](command)
    except (ValueError, OSError) as error:
        print(f"dcgrid: {error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
