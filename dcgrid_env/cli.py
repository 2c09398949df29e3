"""The command line: ``dcgrid run | benchmark | reproduce | tune | hindsight | list | traces``.

The one module that sees all others; it imports them lazily.
"""

from __future__ import annotations

import sys
from typing import Annotated

import tyro

from dcgrid_env.commands import benchmark, hindsight, listing, reproduce, run, traces, tune

Command = (
    Annotated[run.Run, tyro.conf.subcommand("run", description=run.__doc__)]
    | Annotated[benchmark.Benchmark, tyro.conf.subcommand("benchmark", description=benchmark.__doc__)]
    | Annotated[reproduce.Reproduce, tyro.conf.subcommand("reproduce", description=reproduce.__doc__)]
    | Annotated[tune.Tune, tyro.conf.subcommand("tune", description=tune.__doc__)]
    | Annotated[hindsight.HindsightValues, tyro.conf.subcommand("hindsight", description=hindsight.__doc__)]
    | Annotated[listing.List, tyro.conf.subcommand("list", description=listing.__doc__)]
    | Annotated[traces.Traces, tyro.conf.subcommand("traces", description=traces.__doc__)]
)
_MAIN = {
    run.Run: run.main,
    benchmark.Benchmark: benchmark.main,
    reproduce.Reproduce: reproduce.main,
    tune.Tune: tune.main,
    hindsight.HindsightValues: hindsight.main,
    listing.List: listing.main,
    traces.Traces: traces.main,
}


def main(args: list[str] | None = None) -> None:
    """Entry point of ``dcgrid``; bad input ends with one line on standard error and status 2."""
    about = "Voltage control of feeders with data centres."
    bare = (tyro.conf.OmitSubcommandPrefixes,)  # `dcgrid traces fetch`, not `traces action:fetch`
    command = tyro.cli(Command, args=args, prog="dcgrid", description=about, config=bare)
    try:
        _MAIN[type(command)](command)
    except (ValueError, OSError) as error:
        print(f"dcgrid: {error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
