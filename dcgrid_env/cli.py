"""The command line: ``dcgrid run | benchmark | train | evaluate | ship | pareto | ablate | reproduce | list | ..``.

The one module that sees all others; it imports them lazily.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated

import tyro

from dcgrid_env.commands import (
    ablate,
    benchmark,
    curves,
    evaluate,
    generalise,
    hindsight,
    listing,
    pareto,
    reproduce,
    run,
    ship,
    traces,
    train,
    tune,
)

Command = (
    Annotated[run.Run, tyro.conf.subcommand("run", description=run.__doc__)]
    | Annotated[benchmark.Benchmark, tyro.conf.subcommand("benchmark", description=benchmark.__doc__)]
    | Annotated[train.Train, tyro.conf.subcommand("train", description=train.ABOUT)]
    | Annotated[evaluate.Evaluate, tyro.conf.subcommand("evaluate", description=evaluate.__doc__)]
    | Annotated[ship.Ship, tyro.conf.subcommand("ship", description=ship.__doc__)]
    | Annotated[pareto.Pareto, tyro.conf.subcommand("pareto", description=pareto.__doc__)]
    | Annotated[ablate.Ablate, tyro.conf.subcommand("ablate", description=ablate.__doc__)]
    | Annotated[generalise.Generalise, tyro.conf.subcommand("generalise", description=generalise.__doc__)]
    | Annotated[curves.Curves, tyro.conf.subcommand("curves", description=curves.__doc__)]
    | Annotated[reproduce.Reproduce, tyro.conf.subcommand("reproduce", description=reproduce.__doc__)]
    | Annotated[tune.Tune, tyro.conf.subcommand("tune", description=tune.__doc__)]
    | Annotated[hindsight.HindsightValues, tyro.conf.subcommand("hindsight", description=hindsight.__doc__)]
    | Annotated[listing.List, tyro.conf.subcommand("list", description=listing.__doc__)]
    | Annotated[traces.Traces, tyro.conf.subcommand("traces", description=traces.__doc__)]
)
_MAIN = {
    run.Run: run.main,
    benchmark.Benchmark: benchmark.main,
    train.Train: lambda cfg: train.main([cfg.algorithm]),
    evaluate.Evaluate: evaluate.main,
    ship.Ship: ship.main,
    pareto.Pareto: pareto.main,
    ablate.Ablate: ablate.main,
    generalise.Generalise: generalise.main,
    curves.Curves: curves.main,
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
    given = sys.argv[1:] if args is None else args
    try:
        if given[:1] == ["train"] and given[1:2] and not given[1].startswith("-"):
            # The algorithm's own options follow, which are not known before it is imported.
            with _terminated_in_order():
                _told(lambda: train.main(given[1:]))
            return
        command = tyro.cli(Command, args=args, prog="dcgrid", description=about, config=bare)
        resumes = _resumes(command)
        with _terminated_in_order():
            _told(lambda: _MAIN[type(command)](command))
    except KeyboardInterrupt:
        print("dcgrid: interrupted" + "; the same command goes on from there" * resumes, file=sys.stderr)
        raise SystemExit(_INTERRUPTED) from None


@contextmanager
def _terminated_in_order() -> Iterator[None]:
    """Let SIGTERM end the command by an exception, so that nothing half written is left, as Ctrl-C does."""

    def end(number: int, frame: object) -> None:
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _told(work: Callable[[], None]) -> None:
    """Do the work; bad input is one line."""
    try:
        work()
    except (ValueError, OSError) as error:
        print(f"dcgrid: {error}", file=sys.stderr)
        raise SystemExit(2) from None


def _resumes(command: Command) -> bool:
    """Whether a command keeps what it has done, and does not do it again."""
    if isinstance(command, traces.Traces):
        return isinstance(command.action, traces.Fetch)
    if isinstance(command, tune.Tune):
        return not command.again
    return isinstance(command, hindsight.HindsightValues | pareto.Pareto | ablate.Ablate | generalise.Generalise)


if __name__ == "__main__":
    main()
