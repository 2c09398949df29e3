"""The table of commands: where each stands, what an older spelling gets, and what help says."""

import dataclasses
import os
import re
import subprocess
import sys

import pytest

import dcgrid_env
from dcgrid_env.cli.command import Command, Group
from dcgrid_env.cli.main import COMMANDS, DEV, main


def commands(group=COMMANDS, prog="dcgrid"):
    """Every command with its words."""
    for name, member in group.members.items():
        if isinstance(member, Group):
            yield from commands(member, f"{prog} {name}")
        else:
            yield f"{prog} {name}", member


def stopped(capsys, *arguments):
    with pytest.raises(SystemExit) as raised:
        main(list(arguments))
    return raised.value.code, capsys.readouterr()


@pytest.mark.parametrize("name", DEV.members)
def test_an_older_spelling_is_one_line_with_the_newer(capsys, name):
    code, said = stopped(capsys, name, "--workers", "1")
    assert (code, said.err) == (2, f"dcgrid: there is no `dcgrid {name}`; it is `dcgrid dev {name}`\n")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["show"], "there is no `dcgrid show`; it is `dcgrid traces show`"),
        (["nothing"], "`dcgrid` has no command 'nothing'; there are run, check, benchmark, train, "),
        (["dev", "nothing"], "`dcgrid dev` has no command 'nothing'; there are hindsight, "),
        (["dev", "tune", "--laws", "droop"], "there is no `dcgrid dev tune`; it is `dcgrid tune`"),
    ],
)
def test_a_command_that_there_is_not_is_one_line(capsys, arguments, message):
    code, said = stopped(capsys, *arguments)
    assert code == 2
    assert said.err.startswith(f"dcgrid: {message}")
    assert len(said.err.splitlines()) == 1


@pytest.mark.parametrize("words", [prog.split()[1:] for prog, _ in commands()] + [[], ["dev"], ["train"], ["traces"]])
def test_every_help_is_shown_and_stands_alone(capsys, monkeypatch, words):
    monkeypatch.setenv("COLUMNS", "500")
    code, said = stopped(capsys, *words, "--help")
    assert code == 0
    lines = [line.strip("│ ").strip() for line in said.out.splitlines()]
    assert lines[0].startswith(" ".join(["usage: dcgrid", *words, "[-h]"]))
    texts = [lines[2], *(re.sub(r"^(-\S+ |[A-Z]+ |\{.*?\} |\[.*?\] |• \S+|\S+ *$)*", "", line) for line in lines[3:])]
    for text in (re.split(r" {2,}", text)[-1] for text in texts):
        assert not re.match(r"(Of|The same|As) ", text), text
    assert lines[2].endswith((".", ":")), lines[2]


@pytest.mark.parametrize("prog", [prog for prog, member in commands() if isinstance(member, type)])
def test_a_command_is_a_dataclass_that_runs(prog):
    member = dict(commands())[prog]
    assert isinstance(member, type)
    assert issubclass(member, Command)
    assert dataclasses.is_dataclass(member)
    assert member.__doc__ is not None
    assert not getattr(member, "__abstractmethods__", None)  # it has a run() of its own


def test_what_goes_on_after_an_interruption():
    words = {
        "run": "", "benchmark": "", "evaluate none": "", "evaluate none --hindsight": "the same command",
        "tune": "the same command", "tune --again": "", "dev hindsight": "the same command",
        "traces fetch x": "the same command", "traces show x": "", "train analytic": "the same command with --resume",
    }  # fmt: skip
    for line, start in words.items():
        resumes = COMMANDS.parse(line.split(), "dcgrid").resumes
        assert resumes.startswith(start), line
        assert bool(resumes) == bool(start), line


def test_the_version_is_shown_and_loads_nothing_heavy(capsys):
    main(["--version"])
    assert capsys.readouterr().out == f"dcgrid {dcgrid_env.__version__}\n"
    assert "--version shows the version" in COMMANDS.about()


@pytest.mark.parametrize(
    "line", ["train ppo", "train analytic", "run", "evaluate", "benchmark", "tune", "dev hindsight"]
)
def test_help_names_scenario_files(line, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "500")
    assert "path/to/file.toml" in stopped(capsys, *line.split(), "--help")[1].out


@pytest.mark.parametrize("second", [["--set", "load_sigma=0.1"], ["--set=load_sigma=0.1"]])
def test_overrides_given_in_two_places_are_refused(second, capsys):
    code, said = stopped(capsys, "run", "--set", "horizon=5", *second)
    assert (code, len(said.err.splitlines())) == (2, 1)
    assert "--set is there more than once; give it once" in said.err


def test_a_reader_that_stops_ends_a_command_in_silence():
    read, write = os.pipe()
    os.close(read)
    words = [sys.executable, "-m", "dcgrid_env.cli", "run", "--help"]
    ended = subprocess.run(words, stdout=write, stderr=subprocess.PIPE, check=False, timeout=60)
    os.close(write)
    assert (ended.returncode, ended.stderr) == (141, b"")


TAKING_TUNED = [(prog, member) for prog, member in commands() if "tuned" in getattr(member, "__dataclass_fields__", ())]


@pytest.mark.parametrize("prog", [prog for prog, _ in TAKING_TUNED])
def test_a_file_of_gains_that_is_not_there_is_refused_whatever_is_to_run(prog, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    policy = ["toy6-analytic"] if prog == "dcgrid evaluate" else []
    law = [] if policy else ["--compare" if prog == "dcgrid replay" else "--controllers", "none"]
    law = ["--controller", "none"] if prog == "dcgrid dataset" else law
    code, said = stopped(capsys, *prog.split()[1:], *policy, "--scenario", "toy6", *law, "--tuned", "none.json")
    assert (code, said.err) == (2, "dcgrid: tuned is 'none.json', which is no file; give one that dcgrid tune wrote\n")
    assert not list(tmp_path.iterdir())


def test_commands_that_take_a_file_of_gains():
    assert [prog.split()[1] for prog, _ in TAKING_TUNED] == [
        "run", "benchmark", "evaluate", "replay", "dataset", "capacity"
    ]  # fmt: skip
