"""Where the command ``dcgrid`` begins: outside the package, so that Ctrl-C is handled before the package loads."""

import os
import signal


def main() -> None:
    """Run the command line; Ctrl-C ends the process at once while nothing but modules is loaded, and after the end."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else the shell has it ignored
        signal.signal(signal.SIGINT, _end)
    from dcgrid_env.cli.main import main as command_line

    command_line()


def _end(number: int, frame: object) -> None:
    """No exception, which libraries and Python's own import swallow now and then."""
    os.write(2, b"dcgrid: interrupted\n")
    os._exit(130)
