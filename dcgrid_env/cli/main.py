"""The command line, ``dcgrid``: run a command, and report an error or an interruption.

This is the one room that sees all others; a command is imported when it runs.
"""

from __future__ import annotations

import signal
import sys
import traceback
from collections.abc import Sequence

from dcgrid_command.command_table import COMMANDS, TRACEBACK, VERSION
from dcgrid_command.group import HELP, Entry, Group, found
from dcgrid_command.unread import ends_unread
from dcgrid_env import __version__
from dcgrid_env.cli.command import Command
from dcgrid_env.cli.terminal import any_characters
from dcgrid_env.core.signals import raising
from dcgrid_env.core.suggestions import unknown
from dcgrid_env.core.versions import command_of
from dcgrid_env.core.work.worker import terminated_in_order

_INTERRUPTED = 130
"""Status that shells give to what Ctrl-C has ended."""


def main(args: list[str] | None = None, commands: Group = COMMANDS, prog: str = "dcgrid") -> None:
    """Run a command; bad input ends with one line on standard error and status 2, Ctrl-C with status 130.

    ``prog`` is what calls ``commands``, as it is typed.
    """
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
            command_of([*prog.split(), *words]),
        ):
            if sum(word.partition("=")[0] == "--set" for word in words) > 1:
                raise ValueError("set: --set is there more than once; give it once, with every FIELD=VALUE behind it")
            command = parse([word for word in words if word != TRACEBACK], commands, prog)
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


def parse(words: Sequence[str], commands: Group = COMMANDS, prog: str = "dcgrid") -> Command:
    """Read a command line without what calls the commands.

    Raises ValueError for a command that does not exist, and SystemExit for wrong options and after a help.
    """
    member, line, rest = found(commands, prog, words)
    if isinstance(member, Entry):
        return member.load().parse(rest, line)
    if rest and rest[0] not in HELP:
        raise ValueError(unknown("command", rest[0], dict(commands.below(prog)), f"`{line} --help` lists all"))
    print(member.page(line), file=sys.stdout if rest else sys.stderr)
    raise SystemExit(0 if rest else 2)


if __name__ == "__main__":
    main()
