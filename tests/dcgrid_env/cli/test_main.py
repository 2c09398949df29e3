"""The tables of commands of ``dcgrid`` and of docs/studies: the place of each command, and its help."""

import dataclasses
import itertools
import os
import re
import subprocess
import sys

import pytest

import dcgrid_env
from dcgrid_command.command_table import COMMANDS
from dcgrid_command.group import Entry, Group
from dcgrid_env.cli.main import main, parse
from dcgrid_env.core.commands.command import GOES_ON, Command
from dcgrid_env.scenario.assembly import PARTS
from docs.studies.commands import COMMANDS as STUDIES
from docs.studies.commands import PROG
from docs.studies.commands import main as studies

PLACES = dict(COMMANDS.below("dcgrid")) | dict(STUDIES.below(PROG))
CLASSES = {line: member.load() for line, member in PLACES.items() if isinstance(member, Entry)}
GROUPS = {"dcgrid": COMMANDS, PROG: STUDIES} | {
    line: member for line, member in PLACES.items() if isinstance(member, Group)
}
WIDE = "2000"


def stopped(capsys, *arguments, run=main):
    with pytest.raises(SystemExit) as raised:
        run(list(arguments))
    return raised.value.code, capsys.readouterr()


def helped(capsys, line):
    """The help of a command or group, by the words that call it."""
    words, run = (line.removeprefix(PROG), studies) if line.startswith(PROG) else (line.removeprefix("dcgrid"), main)
    code, said = stopped(capsys, *words.split(), "--help", run=run)
    assert code == 0
    return said.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["show"], "no command 'show'; did you mean dcgrid traces show? `dcgrid --help` lists all"),
        (["trian", "ppo"], "no command 'trian'; did you mean dcgrid train? "),
        (["nothing"], "no command 'nothing'; `dcgrid --help` lists all"),
        (["dev", "hindsight"], "no command 'dev'; `dcgrid --help` lists all"),
        (["train", "--seed", "1"], "no command '--seed'; `dcgrid train --help` lists all"),
    ],
)
def test_an_unknown_command_is_one_line(capsys, arguments, message):
    code, said = stopped(capsys, *arguments)
    assert code == 2
    assert said.err.startswith(f"dcgrid: {message}")
    assert len(said.err.splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("run --set foo=1", "set: no scenario field 'foo'; `dcgrid list fields` lists all"),
        ("run --set horizn=1", "set: no scenario field 'horizn'; did you mean horizon? `dcgrid list fields` lists all"),
        (
            "run --scenario ieee123x",
            "no scenario 'ieee123x'; did you mean ieee123, .*`dcgrid list scenarios`",
        ),
        ("run --feeder iee33", "no feeder 'iee33'; did you mean ieee33, .*`dcgrid list feeders` lists all"),
        (
            "run --controllers drop",
            "no controller 'drop'; did you mean droop or droop-q. `dcgrid list controllers`",
        ),
        ("run --trace infrence", "no trace 'infrence'; did you mean inference. `dcgrid list traces` lists all"),
        ("evaluate toy6-anlytic", "no controller 'toy6-anlytic'; did you mean toy6-analytic, "),
    ],
)
def test_an_unknown_name_gets_suggestions_and_where_all_are_listed(capsys, arguments, said):
    code, shown = stopped(capsys, *arguments.split())
    assert code == 2
    assert re.match(f"dcgrid: {said.replace('?', '.')}", shown.err), shown.err


@pytest.mark.slow
def test_fields_are_listed_with_what_each_is(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", WIDE)
    main(["list", "fields"])
    listed = {line.split()[0]: line.split(maxsplit=1)[1:] for line in capsys.readouterr().out.splitlines() if line}
    fields = {
        *dcgrid_env.Scenario.__dataclass_fields__,
        "sensing.noise_pu",
        "datacenters.buses",
        "n_datacenters",
    } - set(PARTS)
    assert fields <= set(listed)
    assert all(listed.values())


def test_the_commands_are_in_their_groups():
    assert {title: list(commands) for title, commands in COMMANDS.sections.items()} == {
        "Get started": ["run", "list", "replay"],
        "Your feeder": ["import", "check", "capacity", "study", "export"],
        "Train and evaluate": ["train", "evaluate", "tune", "hindsight", "benchmark", "dataset"],
        "Publish": ["submit", "verify", "export-sb3", "reproduce"],
        "Data": ["traces"],
    }


@pytest.mark.parametrize("line", GROUPS)
def test_a_page_lists_every_command_on_one_line(line, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    page = helped(capsys, line)
    lines = page.splitlines()
    assert page.isascii()
    assert max(map(len, lines)) <= 80
    shown = [re.split(r" {2,}", row.strip()) for row in lines if row.startswith("  ")]
    assert shown[: -1 - len(GROUPS[line].options)] == [[name, at.text] for name, at in GROUPS[line].members.items()]


@pytest.mark.parametrize("words", [["--help"], ["-h"], ["train", "--help"]])
def test_a_page_is_shown_before_the_package_loads(words):
    code = (
        f"import sys; sys.argv = ['dcgrid', *{words}]\nfrom dcgrid_command import main; main()\n"
        "print([m for m in ('dcgrid_env', 'numpy', 'tyro', 'rich', 'gymnasium') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("usage: dcgrid")
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize("words", [[], ["traces"]])
def test_a_group_without_a_command_shows_its_page_and_fails(words, capsys):
    code, said = stopped(capsys, *words)
    assert code == 2
    assert said.err.startswith(" ".join(["usage: dcgrid", *words, "COMMAND"]))


@pytest.mark.parametrize("line", CLASSES)
@pytest.mark.parametrize("columns", ["60", "80", "120"])
def test_a_help_fits_the_terminal(line, columns, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", columns)
    lines = helped(capsys, line).splitlines()
    assert lines[0].startswith(f"usage: {line} [-h]")
    assert max(map(len, lines)) <= int(columns)


@pytest.mark.parametrize("line", CLASSES)
def test_a_help_has_no_line_break_of_the_source_and_no_none(line, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", WIDE)
    page = helped(capsys, line)
    assert not re.search(r"\{None[,}]|\(default: (None)?\)|``|:class:", page)
    lines = page.splitlines()
    about = list(itertools.takewhile(lambda text: not re.match("╭|[ +]-", text), lines[2:-1]))
    assert all(about[::2])
    assert not any(about[1::2])  # a paragraph is a line
    rows = [row.strip("│")[1:].rstrip() for row in lines if re.match(r"(│ | {2,}\S)", row)]
    assert rows
    for before, row in itertools.pairwise(rows):
        starts = re.match(r" ?[-A-Z[]", row)
        assert starts or not re.search(r" {2,}\S", before.lstrip()), row  # a text is on one line


@pytest.mark.parametrize("line", CLASSES)
def test_a_command_is_a_dataclass_that_runs(line):
    kind, entry = CLASSES[line], PLACES[line]
    if line.startswith("dcgrid train "):
        return
    assert issubclass(kind, Command)
    assert dataclasses.is_dataclass(kind)
    assert kind.about().partition("\n\n")[0] == entry.text  # the table and the help agree
    assert not getattr(kind, "__abstractmethods__", None)  # it has a run() of its own


def test_what_goes_on_after_an_interruption():
    words = {
        "run": "", "benchmark": "", "evaluate none": "", "evaluate none --hindsight": GOES_ON,
        "tune": GOES_ON, "tune --again": "", "hindsight": GOES_ON,
        "traces fetch x": GOES_ON, "traces show x": "", "train analytic": "run the same command with --resume",
    }  # fmt: skip
    for line, start in words.items():
        resumes = parse(line.split()).resumes
        assert resumes.startswith(start), line
        assert bool(resumes) == bool(start), line


def test_the_version_is_shown_and_loads_nothing_heavy(capsys):
    main(["--version"])
    assert capsys.readouterr().out == f"dcgrid {dcgrid_env.__version__}\n"
    assert "--version" in COMMANDS.options


@pytest.mark.parametrize("line", ["train ppo", "train analytic", "run", "evaluate", "benchmark", "tune", "hindsight"])
def test_help_names_scenario_files(line, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "500")
    assert "path/to/file.toml" in stopped(capsys, *line.split(), "--help")[1].out


@pytest.mark.parametrize("line", ["list fields", "verify folder"])
def test_options_after_a_list_of_arguments_are_options(line, capsys):
    assert stopped(capsys, *line.split(), "--help")[0] == 0
    code, said = stopped(capsys, *line.split(), "--unknown")
    assert code == 2
    assert "Unrecognized options: --unknown" in said.err


@pytest.mark.parametrize("second", [["--set", "background.load_sigma=0.1"], ["--set=background.load_sigma=0.1"]])
def test_overrides_given_in_two_places_are_refused(second, capsys):
    code, said = stopped(capsys, "run", "--set", "horizon=5", *second)
    assert (code, len(said.err.splitlines())) == (2, 1)
    assert "set: must be given once" in said.err


@pytest.mark.slow
def test_a_reader_that_stops_ends_a_command_in_silence():
    read, write = os.pipe()
    os.close(read)
    words = [sys.executable, "-m", "dcgrid_env.cli", "run", "--help"]
    ended = subprocess.run(words, stdout=write, stderr=subprocess.PIPE, check=False, timeout=60)
    os.close(write)
    assert (ended.returncode, ended.stderr) == (141, b"")


TAKING_TUNED = [line for line, kind in CLASSES.items() if "tuned" in getattr(kind, "__dataclass_fields__", ())]


@pytest.mark.parametrize("prog", TAKING_TUNED)
def test_a_file_of_gains_that_is_not_there_is_refused_whatever_is_to_run(prog, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    policy = ["toy6-analytic"] if prog == "dcgrid evaluate" else []
    law = [] if policy else ["--compare" if prog == "dcgrid replay" else "--controllers", "none"]
    law = ["--controller", "none"] if prog == "dcgrid dataset" else law
    code, said = stopped(capsys, *prog.split()[1:], *policy, "--scenario", "toy6", *law, "--tuned", "none.json")
    assert (code, said.err) == (2, "dcgrid: tuned is 'none.json', which is no file; give one that dcgrid tune wrote\n")
    assert not list(tmp_path.iterdir())


def test_commands_that_take_a_file_of_gains():
    assert [prog.split()[1] for prog in TAKING_TUNED] == [
        "run", "replay", "capacity", "evaluate", "benchmark", "dataset"
    ]  # fmt: skip
