"""Changes of leaderboard entries, and errors of the command line on them."""

import json

import pytest

from dcgrid_env.cli.main import main


def change(path, **fields):
    """Give some fields of a record other values."""
    path.write_text(json.dumps(json.loads(path.read_text()) | fields))


def error_line(capsys, *arguments, run=main):
    """Return the one line of the error with which a command stops."""
    with pytest.raises(SystemExit) as raised:
        run([str(argument) for argument in arguments])
    line = capsys.readouterr().err
    assert (raised.value.code, len(line.splitlines())) == (2, 1), line
    return line
