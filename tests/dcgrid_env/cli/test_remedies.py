"""Remedies in error messages are options of the command line."""

import ast
import dataclasses
import re
from pathlib import Path

import pytest

import dcgrid_env.traces
from dcgrid_env.cli.main import main
from dcgrid_env.cli.remedies import READING, with_options
from dcgrid_env.cli.run import Run
from dcgrid_env.cli.traces import CheckRecording
from dcgrid_env.traces import TraceError
from dcgrid_env.traces.recording_file import FORMATS

CHECK = CheckRecording("site.csv")
RUN = Run()


def literals(folder):
    """The texts in the Python files below a folder; names in them are spelled out."""
    for path in sorted(folder.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                yield "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value


@pytest.mark.slow
def test_every_keyword_of_a_remedy_is_an_option():
    options = {field.name for field in dataclasses.fields(CheckRecording)}
    assert options >= READING
    assert {option for form in FORMATS.values() for option in form.options} <= READING
    remedies = set()
    for text in literals(Path(dcgrid_env.traces.__path__[0])):
        remedies |= set(re.findall(r"\b(?:pass|raise|with|correct|and|or) ([a-z_]+)=(?![=\d])", text))
    assert remedies >= {"unit", "gaps", "gpus", "power_columns"}
    assert remedies <= READING


@pytest.mark.parametrize(
    ("message", "shown"),
    [
        ("pass gaps='hold' or 'linear'", "pass --gaps hold or linear"),
        ("pass unit= (one of W, kW), or", "pass --unit (one of W, kW), or"),
        ("more than max_gap_s = 15; raise max_gap_s, cut", "more than --max-gap-s 15; raise --max-gap-s, cut"),
        ("but gpus = 3; correct gpus", "but --gpus 3; correct --gpus"),
        ("unit = 'kW' is given; leave unit out, or", "--unit kW is given; leave --unit out, or"),
        ("pass unit='mW' or unit='MW', or", "pass --unit mW or --unit MW, or"),
        ("pass columns='timestamp,index', as", "pass --columns timestamp,index, as"),
        ("or pass limit_kw=632 or more if", "or pass --limit-kw 632 or more if"),
        ("choose one with metric=", "choose one with --metric"),
        ("unit 'GW' is unknown; choose one of W", "unit 'GW' is unknown; choose one of W"),
        ("column 'max_gap_s' and load.unit = 3", "column 'max_gap_s' and load.unit = 3"),
        ("log with `dcgmi dmon --unit=3`", "log with `dcgmi dmon --unit=3`"),
    ],
)
def test_keywords_become_options(message, shown):
    assert with_options(TraceError(message), CHECK) == shown


def test_a_command_without_the_option_names_the_command_that_has_it():
    error = ValueError("scenario: a file is wrong")
    error.__cause__ = TraceError("x")
    assert with_options(error, RUN) == "scenario: a file is wrong"
    shown = with_options(TraceError("pass unit=, or raise limit_kw"), RUN)
    assert shown == (
        "pass --unit, or raise --limit-kw; `dcgrid traces check FILE --save NEW.csv` has --unit and --limit-kw; use "
        "the new file"
    )


def test_other_errors_keep_their_words():
    assert with_options(ValueError("write unit=3; columns = 4"), RUN) == "write unit=3; columns = 4"
    assert with_options(ValueError("pass episodes=3"), RUN) == "pass --episodes 3"
    assert with_options(ValueError("pass unit="), None) == "pass unit="


@pytest.mark.slow
def test_the_remedies_work(tmp_path, capsys):
    path, saved = tmp_path / "gpu.csv", tmp_path / "saved.csv"
    lines = [f"2026/03/01 12:{k // 60:02d}:{k % 60:02d}.000, {w}\n" for k in range(60) for w in (300, 310)]
    path.write_text("timestamp, power.draw\n" + "".join(lines))
    for options, message in (
        ([], "pass --unit for readings without one"),
        (["--unit", "W"], "or pass --gpus if the lines"),
    ):
        with pytest.raises(SystemExit):
            main(["traces", "check", str(path), *options])
        assert message in capsys.readouterr().err
    main(["traces", "check", str(path), "--unit", "W", "--gpus", "2", "--save", str(saved)])
    assert "peak 0.61 kW" in capsys.readouterr().out
    main(["traces", "check", str(saved)])
    assert "began 2026-03-01T12:00:00.000" in capsys.readouterr().out
