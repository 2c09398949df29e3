"""The command line: ``dcgrid run | benchmark | train | evaluate | ship | pareto | ablate | reproduce | list | ..``.

The one module that sees all others; it imports them lazily.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable
from typing import Annotated

import tyro

from dcgrid_env.cli import (
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
from dcgrid_env.core.processes import terminated_in_order

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


TRACEBACK = "--traceback"
"""The one option of every command; it may stand anywhere on the line."""
ABOUT = f"Voltage control of feeders with data centres. {TRACEBACK}, with any command, shows an error whole."


def main(args: list[str] | None = None) -> None:
    """Entry point of ``dcgrid``; bad input ends with one line on standard error and status 2, Ctrl-C with 130."""
    bare = (tyro.conf.OmitSubcommandPrefixes,)  # `dcgrid traces fetch`, not `traces action:fetch`
    resumes = False
    asked = sys.argv[1:] if args is None else args
    given, whole = [word for word in asked if word != TRACEBACK], TRACEBACK in asked
    try:
        if given[:1] == ["train"] and given[1:2] and not given[1].startswith("-"):
            # The algorithm's own options follow, which are not known before it is imported.
            with terminated_in_order():
                _told(lambda: train.main(given[1:]), whole)
            return
        command = tyro.cli(Command, args=given, prog="dcgrid", description=ABOUT, config=bare)
        resumes = _resumes(command)
        with terminated_in_order():
            _told(lambda: _MAIN[type(command)](command), whole)
    except KeyboardInterrupt:
        print("dcgrid: interrupted" + "; the same command goes on from there" * resumes, file=sys.stderr)
        raise SystemExit(_INTERRUPTED) from None


def _told(work: Callable[[], None], whole: bool) -> None:
    """Do the work; bad input is one line, or all of it where that is asked for."""
    try:
        work()
    except (ValueError, OSError) as error:
        if whole:
            traceback.print_exception(error)
        else:
            more = f"; {TRACEBACK} shows all of it" if getattr(error, "traced", False) else ""
            print(f"dcgrid: {error}{more}", file=sys.stderr)
        raise SystemExit(2) from None


def _resumes(command: Command) -> bool:
    """Whether a command keeps what it has done, and does not do it again."""
    if isinstance(command, traces.Traces):
        return isinstance(command.action, traces.Fetch)
    if isinstance(command, evaluate.Evaluate):
        return command.hindsight
    if isinstance(command, tune.Tune):
        return not command.again
    return isinstance(command, hindsight.HindsightValues | pareto.Pareto | ablate.Ablate | generalise.Generalise)


if __name__ == "__main__":
    main()
