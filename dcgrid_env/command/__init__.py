"""Entry point of the command ``dcgrid``, a separate package: it handles Ctrl-C before ``dcgrid_env`` loads.

It also shows the help of groups of commands, for which it does not load ``dcgrid_env``.
"""

import os
import signal
import sys

from dcgrid_command.command_table import COMMANDS
from dcgrid_command.group import help_page
from dcgrid_command.streams import complain, standard_streams


def main() -> None:
    """Run the command line. Before and after it, Ctrl-C ends the process at once."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else the shell has it ignored
        signal.signal(signal.SIGINT, _end)
    if page := help_page(COMMANDS, "dcgrid", sys.argv[1:]):
        try:
            with standard_streams():
                print(page)
        except OSError as error:
            complain(f"dcgrid: {error}")
            raise SystemExit(2) from None
        return
    from dcgrid_env.cli.main import main as command_line

    command_line()


def _end(number: int, frame: object) -> None:
    """End the process without an exception, which libraries and Python's import may suppress."""
    os.write(2, b"dcgrid: interrupted\n")
    os._exit(130)
