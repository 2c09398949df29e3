"""Imports that the source's program does not verify: an error, a stamp, and commands that refuse the folder."""

import json
import tomllib
import warnings

import pytest

from dcgrid_env import Feeder, FeederError, ThreePhaseFeeder, load_feeder, read_feeder
from dcgrid_env.apps.importers import import_record
from dcgrid_env.apps.importers.matpower import write_matpower
from dcgrid_env.cli.main import main
from dcgrid_env.grid.formats.import_stamp import AcceptedFeederWarning, UnverifiedFeederWarning, write_stamp

COMMANDS = {
    "run": ["--feeder", "{0}", "--episodes", "1", "--controllers", "none", "--set", "horizon=5"],
    "capacity": ["--feeder", "{0}"],
    "check": ["toy6", "--set", "feeder={0}"],
    "train sac": ["--scenario", "toy6", "--set", "feeder={0}"],
    "export matpower": ["{0}", "--out", "{0}.m"],
}
ACCEPTING = ("run", "capacity", "check", "study")
"""Commands that have the option --allow."""


@pytest.fixture
def stamped(tmp_path):
    """A folder whose import was not verified."""
    load_feeder("ieee33").to_csv(tmp_path / "fed")
    write_stamp(tmp_path / "fed", "voltages differ by 0.1 p.u.", False)
    return tmp_path / "fed"


def refused(capsys, words):
    with pytest.raises(SystemExit) as ended:
        main(words)
    err = capsys.readouterr().err
    assert ended.value.code == 2
    assert err.count("\n") == 1
    return err


@pytest.mark.parametrize("command", [*COMMANDS, "study"])
def test_commands_refuse_a_folder_that_is_not_verified(command, stamped, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.toml").write_text('bus = "18"\nmw = 0.1\nfeeder = "fed"\n')
    words = ["study.toml"] if command == "study" else [word.format(stamped) for word in COMMANDS[command]]
    err = refused(capsys, [*command.split(), *words])
    assert "the import is not verified: voltages differ by 0.1 p.u." in err
    assert ("--allow unverified goes on with it" in err) == (command in ACCEPTING)
    assert "repeat the import with --allow unverified to accept it" in err


@pytest.mark.slow
def test_an_accepted_folder_is_used_and_its_verdict_repeated(stamped, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["run", *(word.format(stamped) for word in COMMANDS["run"])]
    main([*words, "--allow", "unverified"])
    assert capsys.readouterr().err.count("the import is not verified: voltages differ by 0.1 p.u.") == 1
    load_feeder("ieee33").to_csv(stamped)
    write_stamp(stamped, "voltages differ by 0.1 p.u.", True)
    main(words)
    assert "the import is not verified: voltages differ by 0.1 p.u." in capsys.readouterr().err


def test_reading_a_stamped_folder_warns(stamped, tmp_path):
    with pytest.warns(UnverifiedFeederWarning, match="not verified: voltages differ"):
        read_feeder(stamped)
    load_feeder("ieee13-3ph").to_csv(tmp_path / "three")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ThreePhaseFeeder.from_csv(tmp_path / "three")
    write_stamp(tmp_path / "three", 'of "a"', True)
    with pytest.warns(AcceptedFeederWarning, match='of "a"'):
        ThreePhaseFeeder.from_csv(tmp_path / "three")


@pytest.mark.parametrize("stamp", ["import = 3", '[import]\nverdict = "x"', '[import]\nverdict = 1\naccepted = true',
                                   '[import]\nverdict = "x"\naccepted = true\nmore = 1'])  # fmt: skip
def test_a_stamp_that_no_import_writes_is_refused(stamp, tmp_path):
    load_feeder("ieee33").to_csv(tmp_path)
    text = (tmp_path / "feeder.toml").read_text()
    (tmp_path / "feeder.toml").write_text(f"{stamp}\n{text}" if stamp == "import = 3" else f"{text}\n{stamp}\n")
    with pytest.raises(FeederError, match="verdict, a text, and accepted, true or false"):
        Feeder.from_csv(tmp_path)


@pytest.mark.parametrize("accepts", [False, True])
def test_a_balanced_import_whose_voltages_differ_is_stamped(accepts, tmp_path, capsys, monkeypatch):
    write_matpower(load_feeder("toy6"), tmp_path / "toy.m")
    monkeypatch.setattr(import_record, "CLOSE_PU", -1.0)
    out = tmp_path / "out"
    words = ["import", "matpower", str(tmp_path / "toy.m"), "--out", str(out)]
    if accepts:
        main([*words, "--allow", "unverified"])
    else:
        err = refused(capsys, words)
        assert err.startswith(f"dcgrid: {out} is not verified: voltages differ by more than")
        assert "--allow unverified accepts it" in err
    stamp = tomllib.loads((out / "feeder.toml").read_text())["import"]
    assert stamp["accepted"] is accepts
    assert stamp["verdict"].startswith("voltages differ")
    assert json.loads((out / "import_report.json").read_text())["unverified"] == stamp["verdict"]


def test_an_import_that_opendss_verifies_has_no_stamp_and_another_one_has(tmp_path, capsys):
    pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")
    script = (
        "New Circuit.c bus1=a basekv=0.4\nNew Line.l bus1=a bus2=b r1=0.2 x1=0.1 r0=0.5 x0=0.3 c1=0 c0=0\n"
        "New Load.s bus1=b kv=0.4 kw={0} vminpu={1} vlowpu={1}\nSet VoltageBases=[0.4]\nCalcVoltageBases\n"
    )
    (tmp_path / "m.dss").write_text(script.format(9, 0.5))
    main(["import", "opendss", str(tmp_path / "m.dss"), "--out", str(tmp_path / "good")])
    assert "import" not in tomllib.loads((tmp_path / "good" / "feeder.toml").read_text())
    capsys.readouterr()
    (tmp_path / "m.dss").write_text(script.format(9e5, 0.001))
    err = refused(capsys, ["import", "opendss", str(tmp_path / "m.dss"), "--out", str(tmp_path / "bad")])
    assert "voltages are not compared: no power flow solution from" in err
    assert tomllib.loads((tmp_path / "bad" / "feeder.toml").read_text())["import"]["accepted"] is False
