"""Entry point of the command ``dcgrid``, a separate package: it handles Ctrl-C before ``dcgrid_env`` loads."""

import os
import signal


def main() -> None:
    """Run the command line. Before and after it, Ctrl-C ends the process at once."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else the shell has it ignored
        signal.signal(signal.SIGINT, _end)
    from dcgrid_env.cli.main import main as command_line

    command_line()


def _end(number: int, frame: object) -> None:
    """End the process without an exception, which libraries and Python's import may suppress."""
    os.write(2, b"dcgrid: interrupted\n")
    os._exit(130)
