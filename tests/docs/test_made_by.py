"""Commands that data files, cards and docstrings name exist: the command line reads them. Documents: test_blocks.py."""

import contextlib
import io
import json
import re
import shlex
from functools import cache
from pathlib import Path

from dcgrid_command.command_table import COMMANDS
from dcgrid_command.group import Group
from dcgrid_env.cli.main import parse
from docs.studies.commands import COMMANDS as STUDIES
from docs.studies.commands import PROG

ROOT = Path(__file__).parents[2]
ROOMS = ("agents", "apps", "baselines", "dcgrid_env", "docs", "traces")
EARLIER = ROOT / "agents" / "policies" / "smoothing-ppo.json"
"""Made by an earlier form of `ppo`, whose options no longer exist; docs/training.md says so."""
DATA = sorted({path for room in ROOMS for path in (ROOT / room).rglob("*.json")} - {EARLIER})
SOURCES = sorted(path for room in ROOMS for ending in ("py", "toml") for path in (ROOT / room).rglob(f"*.{ending}"))
QUOTED = re.compile(r"`{1,2}((?:dcgrid|python -m docs\.studies) [a-z][^`]+)`{1,2}")
TABLES = {"dcgrid ": (COMMANDS, "dcgrid"), f"{PROG} ": (STUDIES, PROG)}


def table_of(line):
    """The table that a command is of, how it is called, and the words behind that."""
    ((start, (table, prog)),) = ((start, of) for start, of in TABLES.items() if line.startswith(start))
    return table, prog, line.removeprefix(start)


@cache
def read(line):
    """Why the command line does not read a command, "" if it does, and what it prints; nothing is run."""
    table, prog, words = table_of(line)
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            parse(shlex.split(words), table, prog)
    except SystemExit as stopped:
        return ("" if stopped.code in (0, None) else said.getvalue()), said.getvalue()
    except ValueError as error:  # there is no such command
        return str(error), ""
    return "", said.getvalue()


def commands(content):
    """Commands in a JSON file."""
    if isinstance(content, dict | list):
        parts = content.values() if isinstance(content, dict) else content
        return {command for part in parts for command in commands(part)}
    return {content} if isinstance(content, str) and content.startswith(tuple(TABLES)) else set()


def test_commands_in_data_files_can_be_read():
    wrong = {}
    for path in DATA:
        unread = [command for command in commands(json.loads(path.read_text(encoding="utf-8"))) if read(command)[0]]
        wrong |= {str(path.relative_to(ROOT)): unread} if unread else {}
    assert not wrong


def test_commands_in_source_files_exist_with_their_options():
    """Placeholders replace values there, so the test reads only the command and the names of its options."""
    wrong = {}
    for path in SOURCES:
        text = re.sub(r'"\s*\n\s*f?"', "", path.read_text(encoding="utf-8"))
        for quoted in QUOTED.findall(text):
            printed = read(f"{group_and_command(quoted)} --help")[1]
            options = [word for word in quoted.split() if re.fullmatch("--[a-z-]+", word)] if "{" not in quoted else []
            if [option for option in options if option not in printed]:
                wrong.setdefault(str(path.relative_to(ROOT)), []).append(quoted)
    assert not wrong


def group_and_command(line):
    """The words that choose a command, or only a group where a placeholder or nothing follows it."""
    member, chosen, words = table_of(line)
    for word in words.split():
        if not isinstance(member, Group) or word.isupper() or word.startswith(("{", "-")):
            break
        assert word in member.members, line
        member = member.members[word]
        chosen += f" {word}"
    return chosen


def test_data_and_sources_name_commands():
    assert sum(len(commands(json.loads(path.read_text(encoding="utf-8")))) for path in DATA) > 100
    assert sum(len(QUOTED.findall(path.read_text(encoding="utf-8"))) for path in SOURCES) > 50
