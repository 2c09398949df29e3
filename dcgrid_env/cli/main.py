"""The command line, ``dcgrid``: all its commands, and what an error or an interruption looks like.

This is the one room that sees all others; commands import what they need when they run.
"""

from __future__ import annotations

import signal
import sys
import traceback

from dcgrid_env import __version__
from dcgrid_env.cli.ablate import Ablate
from dcgrid_env.cli.agent_search import TuneAgent
from dcgrid_env.cli.benchmark import Benchmark
from dcgrid_env.cli.best_known_values import BestKnownValues
from dcgrid_env.cli.capacity import Capacity
from dcgrid_env.cli.check import Check
from dcgrid_env.cli.command import Command, Group
from dcgrid_env.cli.curves import Curves
from dcgrid_env.cli.dataset import Dataset
from dcgrid_env.cli.evaluate import Evaluate
from dcgrid_env.cli.fit_paper import FitPaper
from dcgrid_env.cli.generalise import Generalise
from dcgrid_env.cli.gradient_cosine import GradientCosine
from dcgrid_env.cli.grid_export import ExportMatpower, ExportPandapower, ExportPowerGridModel
from dcgrid_env.cli.grid_import import ImportMatpower, ImportPandapower, ImportPowerGridModel
from dcgrid_env.cli.hindsight import HindsightValues
from dcgrid_env.cli.leaderboard import Leaderboard
from dcgrid_env.cli.listing import List
from dcgrid_env.cli.opendss_import import ImportOpenDss
from dcgrid_env.cli.pareto import Pareto
from dcgrid_env.cli.random_feeder_table import RandomFeederTable
from dcgrid_env.cli.replay import Replay
from dcgrid_env.cli.reproduce import Reproduce
from dcgrid_env.cli.run import Run
from dcgrid_env.cli.sag_study import Sags
from dcgrid_env.cli.sb3_export import ExportSb3
from dcgrid_env.cli.ship import Rescore, Ship
from dcgrid_env.cli.submit import Submit
from dcgrid_env.cli.terminal import any_characters, ends_unread
from dcgrid_env.cli.traces import Fetch, Record, Show
from dcgrid_env.cli.train import ALGORITHMS
from dcgrid_env.cli.transfer import Transfer
from dcgrid_env.cli.tune import Tune
from dcgrid_env.cli.unit_overhead import UnitOverhead
from dcgrid_env.cli.unseen_feeders import UnseenFeeders
from dcgrid_env.cli.verify import Verify
from dcgrid_env.core.signals import raising
from dcgrid_env.core.versions import command_of
from dcgrid_env.core.work.worker import terminated_in_order

TRACEBACK = "--traceback"
"""The one option of every command; it may stand anywhere on the line."""
VERSION = "--version"
DEV = Group(
    "Make what ships with the package or stands in its documents, or the like for scenarios of your own.",
    {
        "hindsight": HindsightValues,
        "best-known": BestKnownValues,
        "ship": Ship,
        "rescore": Rescore,
        "pareto": Pareto,
        "ablate": Ablate,
        "generalise": Generalise,
        "unseen-feeders": UnseenFeeders,
        "curves": Curves,
        "transfer": Transfer,
        "tune-agent": TuneAgent,
        "sags": Sags,
        "gradient-cosine": GradientCosine,
        "random-feeders": RandomFeederTable,
        "leaderboard": Leaderboard,
        "fit-paper": FitPaper,
        "unit-overhead": UnitOverhead,
    },
    moved={"tune": "dcgrid tune"},
)
"""What maintainers need, and who compares many controllers on a scenario of their own."""
IMPORT = Group(
    "Read feeders from the files of other programs.",
    {
        "opendss": ImportOpenDss,
        "pandapower": ImportPandapower,
        "matpower": ImportMatpower,
        "power-grid-model": ImportPowerGridModel,
    },
)
EXPORT = Group(
    "Write feeders as files of other programs.",
    {"pandapower": ExportPandapower, "matpower": ExportMatpower, "power-grid-model": ExportPowerGridModel},
)
COMMANDS = Group(
    f"Voltage control of feeders with data centres. {TRACEBACK}, with any command, shows an error whole; {VERSION} "
    "shows the version.",
    {
        "run": Run,
        "check": Check,
        "benchmark": Benchmark,
        "train": Group("Train a policy; `dcgrid train ALGORITHM --help` shows an algorithm's options.", ALGORITHMS),
        "evaluate": Evaluate,
        "export-sb3": ExportSb3,
        "submit": Submit,
        "verify": Verify,
        "replay": Replay,
        "tune": Tune,
        "dataset": Dataset,
        "capacity": Capacity,
        "reproduce": Reproduce,
        "list": List,
        "traces": Group("Fetch, show and record power traces.", {"fetch": Fetch, "show": Show, "record": Record}),
        "import": IMPORT,
        "export": EXPORT,
        "dev": DEV,
    },
)
"""Every command, each registered by its line."""
_INTERRUPTED = 130
"""Status that shells give to what Ctrl-C has ended."""


def main(args: list[str] | None = None) -> None:
    """Run a command; bad input ends with one line on standard error and status 2, Ctrl-C with status 130."""
    words = sys.argv[1:] if args is None else args
    if words[:1] == [VERSION]:
        print(f"dcgrid {__version__}")
        return
    command: Command | None = None
    try:
        with (
            raising(signal.SIGINT, KeyboardInterrupt),
            any_characters(),
            ends_unread(),
            terminated_in_order(),
            command_of(words),
        ):
            if sum(word.partition("=")[0] == "--set" for word in words) > 1:
                raise ValueError("set: --set is there more than once; give it once, with every FIELD=VALUE behind it")
            command = COMMANDS.parse([word for word in words if word != TRACEBACK], "dcgrid")
            command.run()
    except (ValueError, OSError) as error:
        if TRACEBACK in words:
            traceback.print_exception(error)
        else:
            more = f"; {TRACEBACK} shows all of it" if getattr(error, "traced", False) else ""
            print(f"dcgrid: {error}{more}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        how = f"; {command.resumes}" if command is not None and command.resumes else ""
        print(f"dcgrid: interrupted{how}", file=sys.stderr)
        raise SystemExit(_INTERRUPTED) from None


if __name__ == "__main__":
    main()
