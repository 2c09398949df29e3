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


_INTERRUPTED = 130
"""Status that shells give to what Ctrl-C has ended."""


def main(args: list[str] | None = None) -> None:
    """Entry point of ``dcgrid``; bad input ends with one line on standard error and status 2, Ctrl-C with 130."""
    about = "Voltage control of feeders with data centres."
    bare = (tyro.conf.OmitSubcommandPrefixes,)  # `dcgrid traces fetch`, not `traces action:fetch`
    resumes = False
    try:
        command = tyro.cli(Command, args=args, prog="dcgrid", description=about, config=bare)
        resumes = _resumes(command)
        _run(command)
    except KeyboardInterrupt:
        print("dcgrid: interrupted" + "; the same command goes on from there" * resumes, file=sys.stderr)
        raise SystemExit(_INTERRUPTED) from None


def _run(command: Command) -> None:
    try:
        _MAIN[type(command)](command)
    except (ValueError, OSError) as error:
        print(f"dcgrid: {error}", file=sys.stderr)
        raise SystemExit(2) from None


def _resumes(command: Command) -> bool:
    """Whether a command keeps what it has done, and does not do it again."""
    if isinstance(command, traces.Traces):
        return isinstance(command.action, traces.Fetch)
    if isinstance(command, tune.Tune):
        return not command.again
    return isinstance(command, hindsight.HindsightValues)


if __name__ == "__main__":
    main()
