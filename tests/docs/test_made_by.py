"""Commands that data files, cards and docstrings name exist: the command line reads them. Documents: test_blocks.py."""

import contextlib
import io
import json
import re
import shlex
from functools import cache
from pathlib import Path

import pytest

from dcgrid_command.command_table import COMMANDS
from dcgrid_command.group import Group
from dcgrid_env.cli.main import parse

ROOT = Path(__file__).parents[2]
ROOMS = ("agents", "baselines", "dcgrid_env", "docs", "traces")
DATA = sorted(path for room in ROOMS for path in (ROOT / room).rglob("*.json"))
SOURCES = sorted(path for room in ROOMS for ending in ("py", "toml") for path in (ROOT / room).rglob(f"*.{ending}"))
QUOTED = re.compile(r"`{1,2}dcgrid ([a-z][^`]+)`{1,2}")


@cache
def read(*words):
    """Why the command line does not read a command, "" if it does, and what it prints; nothing is run."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            parse(words)
    except SystemExit as stopped:
        return ("" if stopped.code in (0, None) else said.getvalue()), said.getvalue()
    except ValueError as error:  # there is no such command
        return str(error), ""
    return "", said.getvalue()


def commands(content):
    """Commands of dcgrid in a JSON file."""
    if isinstance(content, dict | list):
        parts = content.values() if isinstance(content, dict) else content
        return {command for part in parts for command in commands(part)}
    return {content} if isinstance(content, str) and content.startswith("dcgrid ") else set()


@pytest.mark.parametrize("path", DATA, ids=lambda path: str(path.relative_to(ROOT)))
def test_commands_in_a_data_file_can_be_read(path):
    for command in commands(json.loads(path.read_text(encoding="utf-8"))):
        assert not read(*shlex.split(command)[1:])[0], command


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_commands_in_a_source_file_exist_with_their_options(path):
    """Placeholders replace values there, so the test reads only the command and the names of its options."""
    text = re.sub(r'"\s*\n\s*f?"', "", path.read_text(encoding="utf-8"))
    for quoted in QUOTED.findall(text):
        words = quoted.split()
        named = group_and_command(words)
        printed = read(*named, "--help")[1]
        options = [word for word in words if re.fullmatch("--[a-z-]+", word)] if "{" not in quoted else []
        assert not [option for option in options if option not in printed], f"dcgrid {quoted}"


def group_and_command(words):
    """The words that choose a command, or only a group where a placeholder or nothing follows it."""
    member, chosen = COMMANDS, []
    for word in words:
        if not isinstance(member, Group) or word.isupper() or word.startswith(("{", "-")):
            break
        assert word in member.members, f"dcgrid {' '.join(words)}"
        member = member.members[word]
        chosen.append(word)
    return chosen


def test_data_and_sources_name_commands():
    assert sum(len(commands(json.loads(path.read_text(encoding="utf-8")))) for path in DATA) > 100
    assert sum(len(QUOTED.findall(path.read_text(encoding="utf-8"))) for path in SOURCES) > 50
