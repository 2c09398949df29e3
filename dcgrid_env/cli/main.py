"""The command line, ``dcgrid``: run a command, and report errors and interruptions.

Commands may import every other package; a command is imported when it runs.
"""

from __future__ import annotations

import signal
import sys
import traceback
from collections.abc import Sequence

from dcgrid_command.command_table import COMMANDS, TRACEBACK, VERSION
from dcgrid_command.group import HELP, Entry, Group, resolve
from dcgrid_command.streams import complain, standard_streams
from dcgrid_env import __version__
from dcgrid_env.cli.remedies import with_options
from dcgrid_env.cli.stamps import stamps_respected
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.terminal import any_characters
from dcgrid_env.core.plugins import tolerate_malformed
from dcgrid_env.core.signals import raising, terminated_in_order
from dcgrid_env.core.suggestions import unknown
from dcgrid_env.core.versions import command_of

_INTERRUPTED = 130
"""Exit status that shells report after Ctrl-C."""


def main(args: list[str] | None = None, commands: Group = COMMANDS, prog: str = "dcgrid") -> None:
    """Run a command; exit with status 2 and one line on standard error for invalid input, with status 130 for Ctrl-C.

    ``prog`` is the program name that precedes a command, as the user types it.
    """
    words = sys.argv[1:] if args is None else args
    command: Command | None = None
    try:
        with (
            standard_streams(),
            raising(signal.SIGINT, KeyboardInterrupt),
            any_characters(),
            terminated_in_order(),
            command_of([*prog.split(), *words]),
        ):
            if words[:1] == [VERSION]:
                print(f"dcgrid {__version__}")
                return
            tolerate_malformed()
            if sum(word.partition("=")[0] == "--set" for word in words) > 1:
                raise ValueError("set: must be given once; put every FIELD=VALUE after a single --set")
            command = parse([word for word in words if word != TRACEBACK], commands, prog)
            with stamps_respected(getattr(command, "allow", None)):
                command.run()
    except (ValueError, OSError, MemoryError) as error:
        if TRACEBACK in words:
            complain("".join(traceback.format_exception(error)).rstrip("\n"))
        else:
            more = f"; add {TRACEBACK} for the full traceback" if getattr(error, "traced", False) else ""
            no_memory = f"not enough memory {error}; give smaller numbers"
            message = no_memory if isinstance(error, MemoryError) else with_options(error, command)
            complain(f"dcgrid: {message}{more}")
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        how = f"; {command.resumes}" if command is not None and command.resumes else ""
        complain(f"dcgrid: interrupted{how}")
        raise SystemExit(_INTERRUPTED) from None


def parse(words: Sequence[str], commands: Group = COMMANDS, prog: str = "dcgrid") -> Command:
    """Parse a command line without the program name.

    Raises ValueError if the command does not exist, and SystemExit if an option is invalid, and after the help.
    """
    member, line, rest = resolve(commands, prog, words)
    if isinstance(member, Entry):
        return member.load().parse(rest, line)
    if rest and rest[0] not in HELP:
        raise ValueError(unknown("command", rest[0], dict(commands.below(prog)), f"`{line} --help` lists all"))
    print(member.page(line), file=sys.stdout if rest else sys.stderr)
    raise SystemExit(0 if rest else 2)


if __name__ == "__main__":
    main()
